"""Policy learning behind the filter, and adversarial policies that learn to defeat it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
