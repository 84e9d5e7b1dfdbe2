"""Drives at poles with a lidar that loses beams."""
