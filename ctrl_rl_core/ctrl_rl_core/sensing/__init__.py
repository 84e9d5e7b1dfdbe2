"""What a robot senses: scans, odometry, poses and goals, read from messages and checked in one place; no ROS."""
