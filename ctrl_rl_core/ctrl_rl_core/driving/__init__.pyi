from .command_output import ThrustOutput as ThrustOutput
from .driver_node import ENDED as ENDED
from .path_driver import PathDriver as PathDriver
from .path_view import PathView as PathView
