"""Learning joint policies: what imports torch."""
