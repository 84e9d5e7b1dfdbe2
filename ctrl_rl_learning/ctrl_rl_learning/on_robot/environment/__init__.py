"""The ROS-free part of the environment: step clock, operator, rewards and the Gymnasium interface."""
