"""Robot system models (thesis Table 3.1), each written once for NumPy, Numba and CasADi."""
