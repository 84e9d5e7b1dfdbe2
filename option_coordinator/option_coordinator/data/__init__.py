"""Option-level joint trajectories (thesis Definition 1), from environments and from bags."""
