"""Bags in rosbag2's formats: write, read, recover, copy, record, play, and align topics in time."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
