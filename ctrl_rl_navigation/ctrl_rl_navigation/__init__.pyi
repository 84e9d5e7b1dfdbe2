from .errors import NavigationError as NavigationError
from .robot import DriveLimits as DriveLimits
from .values.map_solver import MapSolver as MapSolver
from .values.map_value import MapValue as MapValue
