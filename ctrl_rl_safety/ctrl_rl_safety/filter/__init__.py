"""From a raw command to the nearest one that has a certified escape, without ROS."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
