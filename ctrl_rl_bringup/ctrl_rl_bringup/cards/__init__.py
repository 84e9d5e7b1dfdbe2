"""Cards of policies: origin, success with its limits, observation and commands; and the zoo of shipped policies."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
