"""Learners and how they act (thesis Algorithm 2 and its ablations)."""
