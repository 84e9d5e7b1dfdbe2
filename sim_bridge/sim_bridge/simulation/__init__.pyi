from .occupancy import draw_map as draw_map
from .odometry import Localiser as Localiser
from .odometry import correction as correction
