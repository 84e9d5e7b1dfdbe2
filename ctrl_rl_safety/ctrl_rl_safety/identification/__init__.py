"""Constants of a robot from its commands and its odometry."""
