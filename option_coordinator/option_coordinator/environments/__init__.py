"""Event-driven environments, timelines and roll-outs."""
