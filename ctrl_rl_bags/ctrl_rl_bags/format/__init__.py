"""The rosbag2 format: reading, writing, copying and mending, without an installed ROS."""
