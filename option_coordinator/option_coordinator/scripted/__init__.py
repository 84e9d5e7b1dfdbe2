"""Hand-written policies: baselines, optima, and coordination without a file."""
