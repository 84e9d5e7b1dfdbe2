"""Time-to-reach functions: one grid, or several joined, and their files."""
