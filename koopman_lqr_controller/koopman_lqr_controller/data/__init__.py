"""Recorded drives and roll-outs as training data."""
