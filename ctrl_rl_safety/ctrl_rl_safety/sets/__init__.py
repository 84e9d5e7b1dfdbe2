"""Distances to the echoes of a scan, and the states from which the robot can still stop in time."""
