"""The runs and comparisons of thesis 5.3."""
