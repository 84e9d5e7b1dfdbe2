"""From a raw command to the nearest one that has a certified escape, without ROS."""
