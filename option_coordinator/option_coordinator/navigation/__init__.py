"""Delivery options for small robots: their work, and a reactive planner."""
