from .planar_engine import shape_row as shape_row
