"""Time-aligned arrays from bags."""
