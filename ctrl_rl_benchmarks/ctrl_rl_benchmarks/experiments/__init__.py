"""Runs of the ladder, and their table."""
