"""Coordination of robots by options: joint policies, coordinator and clients, environments, and team files."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
