"""Whole runs on one machine: simulator, driver, recorder and report, for one robot or a team."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
