"""Learners that see nothing but recorded transitions."""
