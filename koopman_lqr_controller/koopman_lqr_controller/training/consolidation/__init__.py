"""Consolidation: a learnt controller becomes the LQR of its own model."""
