"""Many robots of one task, each in its own world, stepped together, fast enough for learning."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
