"""Robots, one file each: size, limits, delay, wheels and lidar, for simulator, nodes, filter and pre-flight."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
