"""The base of every node that drives a robot: scan checks, obstacle stop, watchdog."""
