"""Torch networks, losses and the differentiable LQR (thesis 4.2)."""
