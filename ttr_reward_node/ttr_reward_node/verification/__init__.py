"""Checks of solutions: driving by them, exact references, convergence, cost."""
