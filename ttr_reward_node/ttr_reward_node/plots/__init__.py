"""Plots of values and of checks of solutions."""
