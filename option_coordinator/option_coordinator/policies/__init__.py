"""Conditional joint policies (thesis Eq. 5.2, 5.3) and their files. NumPy only."""
