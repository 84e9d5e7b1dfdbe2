"""Drives of cars to goals with a heading, beside a hybrid A*."""
