"""Work that arrives while a team is at it: tasks, their states in a file, admission and assignment. No ROS."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
