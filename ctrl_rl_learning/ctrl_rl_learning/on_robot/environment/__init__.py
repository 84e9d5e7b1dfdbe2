"""The environment, without ROS: steps of a clock, operator, rewards and the Gymnasium interface."""
