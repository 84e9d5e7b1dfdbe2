from .units import Point as Point
from .units import PositiveTime as PositiveTime
from .units import TimeStep as TimeStep
from .units import parse_interval as parse_interval
