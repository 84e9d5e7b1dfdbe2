"""Learnt policies as they run on a robot: interface, observation and files."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
