"""How a small robot carries out a delivery option."""
