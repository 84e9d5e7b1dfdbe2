"""Grants options to robots that finish at different times (thesis 2.4 and 5)."""
