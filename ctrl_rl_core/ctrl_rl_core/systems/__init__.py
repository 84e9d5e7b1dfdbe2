"""Robot system models (thesis Table 3.1), each written once for NumPy, Numba and CasADi."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
