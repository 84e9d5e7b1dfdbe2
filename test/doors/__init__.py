"""Drives through doors that are a little wider than the filter's certificate needs."""
