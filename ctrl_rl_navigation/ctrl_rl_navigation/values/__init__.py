"""The time to reach a goal on a map: speeds, fast marching, the value function and its solver."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
