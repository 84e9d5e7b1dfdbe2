"""Optimal-control return-to-go as a policy-gradient baseline (thesis 3.3)."""
