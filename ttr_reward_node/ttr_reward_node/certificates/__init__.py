"""Certificates of times to reach: drives and paths back that a solution has to agree with."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
