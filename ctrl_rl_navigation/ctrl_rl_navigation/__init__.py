"""Drives a robot to any goal on a map, based on the time to reach it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
