"""Shipped policies in both physics engines, as they were learnt and with what may differ on a robot."""
