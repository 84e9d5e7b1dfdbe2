"""ROS side of learning on a robot: the node for sensors and commands, and the robots built on it."""
