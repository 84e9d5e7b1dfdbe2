from .simulation import DriveSimulation as DriveSimulation
from .simulation import Errors as Errors
from .simulation import task_content as task_content
