"""Distances to the echoes of a scan, and the states around the robot from which it can still stop in time."""
