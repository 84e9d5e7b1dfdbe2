"""Predictions of what a policy would earn, from bags of other drivers."""
