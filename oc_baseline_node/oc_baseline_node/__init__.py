"""Optimal-control return-to-go as a policy-gradient baseline (thesis 3.3)."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
