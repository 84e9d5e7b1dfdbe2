"""From value, pose and scan to a command: look-ahead, unmapped obstacles, and the navigator."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
