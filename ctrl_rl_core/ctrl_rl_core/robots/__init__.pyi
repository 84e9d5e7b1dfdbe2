from .robot import DEFAULT_ROBOT as DEFAULT_ROBOT
from .robot import robot_names as robot_names
