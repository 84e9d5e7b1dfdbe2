"""Time-to-reach problems (thesis Eq. 2.17-2.20): system, grid, target, obstacles."""
