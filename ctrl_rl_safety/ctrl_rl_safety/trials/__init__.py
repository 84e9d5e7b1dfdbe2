"""Simulated episodes with and without the filter, driven by adversaries and by shipped policies."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
