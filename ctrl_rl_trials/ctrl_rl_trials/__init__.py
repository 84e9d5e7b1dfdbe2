"""Comparative trials: tasks that discriminate between learning methods, uses of a value function, robots, worlds."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
