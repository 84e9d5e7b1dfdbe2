from .value_slices import draw_slices as draw_slices
