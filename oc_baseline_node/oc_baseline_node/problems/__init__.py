"""Optimal control problems of tasks (thesis Eq. 3.11, 3.12)."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
