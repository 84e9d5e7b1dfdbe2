"""Optimal control problems of tasks (thesis Eq. 3.11, 3.12)."""
