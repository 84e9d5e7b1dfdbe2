"""The rosbag2 format: reading, writing, copying and repairing, without an installed ROS."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
