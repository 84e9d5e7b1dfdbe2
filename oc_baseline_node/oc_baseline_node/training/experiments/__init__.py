"""The runs and comparisons of thesis 3.3.3."""
