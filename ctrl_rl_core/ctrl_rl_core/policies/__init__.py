"""Learnt policies as a robot runs them: their interface, observation and files."""
