"""Policies from bags alone: offline learning, evaluation before driving, and the closed loop of both."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
