"""Safety filter: modifies commands so that the robot can provably always stop without contact."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
