"""Plane geometry, quantities with units, and poses from odometry."""
