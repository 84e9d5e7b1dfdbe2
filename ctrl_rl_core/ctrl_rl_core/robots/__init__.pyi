from .robot import DEFAULT_ROBOT as DEFAULT_ROBOT
