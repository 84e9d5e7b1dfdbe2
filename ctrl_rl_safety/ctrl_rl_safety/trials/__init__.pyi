from .driving import drive as drive
from .episodes import CAR as CAR
