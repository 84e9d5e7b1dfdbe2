"""The ladder of tasks: its files, how hard each is, its runs, and their table and pictures."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
