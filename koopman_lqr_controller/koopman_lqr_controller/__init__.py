"""Koopman control: linear models and regulators in lifted coordinates, two-stage or learnt, and their policy files."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
