"""Predicted movers: discs at constant velocity whose place becomes less certain with time.

A mover is a row: position x, y [m], velocity x, y [m/s], radius [m], variance of each coordinate [m^2], covariance of
coordinate and velocity [m^2/s], variance of each velocity [m^2/s^2], probability of this prediction, times from and
until which it holds [s], and standard deviation of the acceleration that it may lack [m/s^2]. A mover may have several
rows: other predictions, and pieces of one that follow each other. Each is at its position at time 0, even if it holds
later.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS = 12
NOBODY: Array = np.empty((0, COLUMNS))
NOBODY.flags.writeable = False
_ACCELERATION = 0.06
"""Standard deviation of the acceleration that a prediction at constant velocity lacks [m/s^2]."""
_SHARPEST, _VAGUEST = 0.03, 0.3
"""Minimum and maximum standard deviation of a predicted place [m]; what is not known now will be seen in time."""
STANDING = 0.7
"""Share of a contact's cost where the robot stands: people walk round what stands more often than round what drives."""
_COST = 40.0
"""Cost of a certain contact, for each second of it [s]."""
_FARTHEST = 4.0
"""Standard deviations beyond which a mover is no risk."""


def mover(
    place: Array,
    velocity: Array,
    radius: float,
    spreads: tuple[float, float, float],
    probability: float = 1.0,
    begin: float = -math.inf,
    end: float = math.inf,
    acceleration: float = _ACCELERATION,
) -> Array:
    """Return a prediction as a row (12,).

    Args:
        place: Position at time 0 (2,) [m].
        velocity: Velocity (2,) [m/s].
        radius: Radius [m].
        spreads: Variance of each coordinate, its covariance with the velocity, and that one's variance.
        probability: Probability of this prediction.
        begin: Time from which it holds [s].
        end: Time until which it holds [s].
        acceleration: Standard deviation of the acceleration that it may lack [m/s^2].
    """
    return np.array((*place, *velocity, radius, *spreads, probability, begin, end, acceleration))


def placed(movers: Array, x: float, y: float, yaw: float) -> Array:
    """Return movers (m, 12) of a frame in the frame that lies at x, y, yaw in it [m, m, rad]."""
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array(((c, -s), (s, c)))
    out = movers.copy()
    out[:, :2], out[:, 2:4] = (movers[:, :2] - (x, y)) @ turn, movers[:, 2:4] @ turn
    return out


def advanced(movers: Array, seconds: float) -> Array:
    """Return movers (m, 12) some seconds later."""
    out = movers.copy()
    out[:, :2] += seconds * movers[:, 2:4]
    out[:, 5] += seconds * (2.0 * movers[:, 6] + seconds * movers[:, 7])
    out[:, 6] += seconds * movers[:, 7]
    out[:, 9:11] -= seconds
    return out


@njit(inline="always")
def holds(movers: Any, i: int, time: float) -> bool:
    """Return whether a prediction holds at a time [s]."""
    return bool(movers[i, 9] <= time < movers[i, 10])


@njit(inline="always")
def spread(movers: Any, i: int, time: float) -> float:
    """Return the variance of a mover's coordinates after a time [m^2]."""
    lack = 0.5 * movers[i, 11] * time * time
    variance = movers[i, 5] + time * (2.0 * movers[i, 6] + time * movers[i, 7]) + lack * lack
    return min(max(variance, _SHARPEST * _SHARPEST), _VAGUEST * _VAGUEST)


@njit(inline="always")
def risk(distance: float, radius: float, variance: float) -> float:
    """Return the cost of a second beside a mover [s/s]: the probability of touching it, times the cost of a contact.

    For a robot that stands it is `STANDING` of that.

    Args:
        distance: Distance of the mover's expected centre [m].
        radius: Distance at which the two touch [m].
        variance: Variance of each of the mover's coordinates [m^2].
    """
    beyond = distance - radius
    if beyond > 0.0 and beyond * beyond > _FARTHEST * _FARTHEST * variance:
        return 0.0
    # The mass of a normal distribution on the disc around its middle, and how that falls across the disc's edge.
    inside = 1.0 - math.exp(-0.5 * radius * radius / variance)
    tail = 0.5 * math.exp(-0.5 * beyond * beyond / variance)
    return _COST * inside * (tail if beyond > 0.0 else 1.0 - tail)
