"""Learners and their actors (thesis Algorithm 2 and its ablations)."""
