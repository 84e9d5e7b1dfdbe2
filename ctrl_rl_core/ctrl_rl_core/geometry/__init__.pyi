from .units import Point as Point
from .units import PositiveTime as PositiveTime
from .units import TimeStep as TimeStep
