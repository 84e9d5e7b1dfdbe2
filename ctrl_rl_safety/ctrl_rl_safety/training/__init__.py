"""The filter while a policy is learnt, and learners that try to get round it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
