"""Joint policies and values in torch."""
