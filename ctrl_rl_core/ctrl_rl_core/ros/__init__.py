"""The base of every node: parameters, executor, signals, diagnostics, and serving of values."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
