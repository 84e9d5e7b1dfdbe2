from .evidence import beams_at as beams_at
from .sensor_filter import SensorFilter as SensorFilter
from .warming import warm_up as warm_up
