"""Watches whether the robot moves as its model says, and whether its lidar points where it is said to point."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
