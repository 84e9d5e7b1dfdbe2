from .movers import MoverCourse as MoverCourse
from .occupancy import draw_map as draw_map
from .odometry import Localiser as Localiser
from .odometry import correction as correction
from .robot import begin_episode as begin_episode
