"""Cars: the time to reach a pose (x, y, heading) for a robot that cannot turn on the spot, and drives by it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
