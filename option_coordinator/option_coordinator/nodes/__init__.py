"""The coordinator node and the nodes of robots."""
