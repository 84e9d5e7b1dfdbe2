"""Consolidation: converts a learnt controller to the LQR of its own model."""
