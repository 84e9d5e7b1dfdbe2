"""Policies as they run on the robot, and their files."""
