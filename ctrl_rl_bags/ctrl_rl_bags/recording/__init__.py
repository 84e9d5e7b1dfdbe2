"""Recording from a ROS graph to a bag, and playing a bag to it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
