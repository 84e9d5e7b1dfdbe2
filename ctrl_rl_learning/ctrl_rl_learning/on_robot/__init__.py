"""Learning on the robot: a Gymnasium environment over ROS topics, an operator who may take over, and fine-tuning."""
