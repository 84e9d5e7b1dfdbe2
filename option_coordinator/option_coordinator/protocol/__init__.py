"""The protocol between robots and coordinators. Pure logic: no ROS, and no clock."""
