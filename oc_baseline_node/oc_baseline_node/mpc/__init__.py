"""Trajectory optimisation and receding-horizon control (thesis Eq. 3.16)."""
