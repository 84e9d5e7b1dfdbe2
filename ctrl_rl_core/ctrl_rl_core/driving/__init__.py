"""Base classes of nodes that drive a robot: scan checks, obstacle stop, watchdog."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
