"""Simulated worlds without ROS: robots, lidar, odometry, episodes."""
