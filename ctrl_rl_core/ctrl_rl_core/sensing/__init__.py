"""Sensor data: scans, odometry, poses and goals, read from messages and validated in one place; no ROS."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
