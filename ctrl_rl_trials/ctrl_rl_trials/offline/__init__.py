"""Closed loops of offline learning: drive, learn from the bags, evaluate, drive again."""
