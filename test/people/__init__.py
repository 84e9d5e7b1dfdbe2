"""Drives of the navigator among people."""
