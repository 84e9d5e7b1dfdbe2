"""Command-line interface of the package."""
