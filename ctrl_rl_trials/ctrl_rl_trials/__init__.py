"""Trials that compare: tasks that tell learning methods apart, ways to use a value function, robots and worlds."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
