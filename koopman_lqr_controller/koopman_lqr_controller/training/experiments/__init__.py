"""The runs and comparisons of thesis 4.3."""
