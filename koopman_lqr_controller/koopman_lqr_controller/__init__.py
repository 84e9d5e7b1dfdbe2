"""Koopman control from lidar: a learned linear model and its LQR (thesis 2.3 and 4)."""
