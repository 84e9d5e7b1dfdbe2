"""Hamilton-Jacobi solvers, and decomposition of large systems (thesis 3.2.2)."""
