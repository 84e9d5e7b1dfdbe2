"""Transitions of recorded drives."""
