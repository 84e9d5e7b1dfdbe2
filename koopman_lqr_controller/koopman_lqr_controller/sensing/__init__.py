"""Observations of a policy from a laser scan and odometry."""
