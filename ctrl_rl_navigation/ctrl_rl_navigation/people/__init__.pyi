from .movers import NOBODY as NOBODY
from .movers import mover as mover
from .space_time import SpaceTime as SpaceTime
from .tracker import Tracker as Tracker
from .watch import Watch as Watch
