from .admission import Admission as Admission
from .assignment import FreeRobot as FreeRobot
from .assignment import assign as assign
from .dispatcher import Dispatcher as Dispatcher
from .task import Change as Change
from .task import Task as Task
from .task import TaskState as TaskState
from .work_queue import WorkQueue as WorkQueue
