from .odometry import ODOMETRY_NAMES as ODOMETRY_NAMES
from .pose import planar as planar
from .scan import DIRECTIONS as DIRECTIONS
from .scan import MOST_BEAMS as MOST_BEAMS
from .scan import echoes as echoes
from .scan import nearest_beams as nearest_beams
from .scan import view_scan as view_scan
from .scan_health import lidar_identity as lidar_identity
