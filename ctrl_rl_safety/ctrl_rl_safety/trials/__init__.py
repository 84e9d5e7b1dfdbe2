"""Episodes in the simulator with and without the filter: adversaries, and the policies that ship."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
