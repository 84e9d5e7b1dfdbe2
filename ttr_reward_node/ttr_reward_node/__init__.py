"""Time-to-reach rewards from Hamilton-Jacobi value functions (thesis 3.2)."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
