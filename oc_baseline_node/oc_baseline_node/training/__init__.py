"""Learning with V_oc as baseline, and its comparisons (thesis 3.3.3). Not needed on robots."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
