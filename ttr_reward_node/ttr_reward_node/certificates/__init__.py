"""Certificates of time-to-reach functions: simulated drives and backward paths that a solution must agree with."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
