"""Runs of every method: training loop, checkpoints, many at a time, results."""
