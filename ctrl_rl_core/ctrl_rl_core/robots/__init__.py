"""Robots, one file each: size, limits, delay, wheels and lidar, for simulator, nodes, filter and pre-flight."""
