"""Resumable training runs, parallel execution, results, and the options of the commands that start them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
