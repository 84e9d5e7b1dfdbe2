"""Policies from bags alone: offline learning, evaluation before driving, and the closed loop of both."""
