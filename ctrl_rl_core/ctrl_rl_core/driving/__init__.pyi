from .arrival import ENDED as ENDED
from .command_output import ThrustOutput as ThrustOutput
from .watchdog_node import INPUT as INPUT
