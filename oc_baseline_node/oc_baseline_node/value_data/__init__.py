"""Value data from solved trajectories, and the fit of V_oc to them (thesis 3.3.2)."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
