"""Monitor whether the robot moves as its model predicts, and whether its lidar is mounted as configured."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
