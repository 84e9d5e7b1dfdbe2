"""Replay, and the state of networks and optimisers as files."""
