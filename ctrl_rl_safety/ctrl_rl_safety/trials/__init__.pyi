from .episodes import CAR as CAR
