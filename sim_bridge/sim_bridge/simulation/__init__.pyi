from .occupancy import draw_map as draw_map
