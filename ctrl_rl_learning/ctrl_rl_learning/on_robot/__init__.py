"""Learning on the robot: a Gymnasium environment over ROS topics, operator take-over, and fine-tuning."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
