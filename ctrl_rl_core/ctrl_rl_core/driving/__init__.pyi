from .command_output import ThrustOutput as ThrustOutput
from .driver_node import ENDED as ENDED
