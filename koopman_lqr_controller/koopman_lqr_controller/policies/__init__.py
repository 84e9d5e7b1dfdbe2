"""Policies as run on the robot, and their files."""
