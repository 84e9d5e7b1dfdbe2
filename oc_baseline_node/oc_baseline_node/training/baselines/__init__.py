"""Policy gradients with baselines and control variates (thesis Eq. 3.14)."""
