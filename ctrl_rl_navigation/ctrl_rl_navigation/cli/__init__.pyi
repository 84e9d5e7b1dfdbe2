from .simulation import TASK_NAME as TASK_NAME
from .simulation import DriveSimulation as DriveSimulation
from .simulation import Errors as Errors
from .simulation import LocalisedRobot as LocalisedRobot
from .simulation import task_content as task_content
