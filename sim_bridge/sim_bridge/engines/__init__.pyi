from .planar_engine import shape_row as shape_row
from .planar_geometry import wheel_speeds as wheel_speeds
from .planar_parts import wheeled_model as wheeled_model
