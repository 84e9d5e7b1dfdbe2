"""Datasets of other libraries from bags, and bags from datasets."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
