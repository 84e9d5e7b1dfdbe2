"""Recording from a ROS graph to a bag, and playing a bag to it."""
