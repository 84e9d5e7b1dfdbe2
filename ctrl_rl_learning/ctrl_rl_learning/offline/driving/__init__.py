"""Drivers, and drives that are recorded."""
