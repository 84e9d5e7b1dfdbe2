from .evidence import beams_at as beams_at
from .passage import least_passage as least_passage
from .sensor_filter import SensorFilter as SensorFilter
from .warming import warm_up as warm_up
