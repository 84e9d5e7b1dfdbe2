"""Guard of a planar quadrotor among known shapes, by simulated escapes with all six states."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
