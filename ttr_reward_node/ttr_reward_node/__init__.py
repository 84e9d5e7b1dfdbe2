"""Time-to-reach rewards from Hamilton-Jacobi value functions (thesis 3.2)."""
