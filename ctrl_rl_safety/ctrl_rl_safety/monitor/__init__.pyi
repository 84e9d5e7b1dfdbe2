from .bounds import Bounds as Bounds
from .model_monitor import ModelMonitor as ModelMonitor
from .mounting import Mounting as Mounting
from .robot_monitor import RobotMonitor as RobotMonitor
