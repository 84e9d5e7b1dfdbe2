"""Linear quadratic control and linear analysis."""
