"""Runs: many at a time, resumable, with their results."""
