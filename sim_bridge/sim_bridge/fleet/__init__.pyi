from .kernels import scans as scans
from .planar_fleet import RATE as RATE
