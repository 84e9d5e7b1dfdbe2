"""People and other movers: tracked in the odometry frame, and given way to in space and time."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
