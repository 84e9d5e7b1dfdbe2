"""DAgger: a student that sees only its lidar learns from an expert that knows the map."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
