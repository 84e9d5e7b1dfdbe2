"""The ladder of tasks: task files, difficulty measures, training runs, tables and pictures."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
