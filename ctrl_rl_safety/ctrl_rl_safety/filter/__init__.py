"""Maps a raw command to the nearest command with a certified escape. No ROS."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
