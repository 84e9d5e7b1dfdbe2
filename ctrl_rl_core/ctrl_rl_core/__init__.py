"""System models, tasks, value functions, files and the base classes of nodes, for every other package."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
