"""Learning with V_oc as baseline, and what it is compared with (thesis 3.3.3). Robots need none of it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
