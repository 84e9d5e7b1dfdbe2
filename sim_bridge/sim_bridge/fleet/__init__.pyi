from .planar_fleet import RATE as RATE
from .planar_fleet import scans as scans
from .vector_environment import NavigationVectorEnv as NavigationVectorEnv
