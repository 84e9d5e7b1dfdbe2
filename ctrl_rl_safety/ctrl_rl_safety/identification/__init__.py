"""Identification of a robot's constants from commands and odometry."""
