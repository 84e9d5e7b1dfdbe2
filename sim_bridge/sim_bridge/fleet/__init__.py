"""Many robots of one task, each in a world of its own, advanced together: as fast as learning wants them."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
