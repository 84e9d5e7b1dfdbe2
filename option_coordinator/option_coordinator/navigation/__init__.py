"""Delivery options on a small robot: their work, and a reactive planner."""
