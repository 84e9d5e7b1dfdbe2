"""Models and regulators identified from data."""
