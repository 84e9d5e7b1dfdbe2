from .entry_points import kernels as kernels
