"""How far obstacles may have come after a time, by what is known of them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import njit


class Growth(NamedTuple):
    """Bounds of motion: of the robot's deviation from its model, and of other movers.

    What is fixed, as walls are, never moves. An echo where there was one all along is known to stand: it may have begun
    to move unnoticed, and moves on with `mover_acceleration`. Any other echo may come at `mover_speed`.

    Attributes:
        disturbance: Bound of the position's deviation for each second of motion [m/s].
        mover_speed: Largest speed of other movers [m/s]; 0 for a static world.
        mover_acceleration: Largest acceleration of what is known to stand [m/s^2].
        begun: Largest speed of what is known to stand, see `unnoticed_speed` [m/s].
    """

    disturbance: float
    mover_speed: float = 0.0
    mover_acceleration: float = 0.0
    begun: float = 0.0


def unnoticed_speed(distance: float, span: float, acceleration: float) -> float:
    """Return the largest speed that a mover may have which stayed within a distance all the time before [m/s].

    Args:
        distance: Distance within which nobody notices a motion [m].
        span: Time for which it stayed there [s].
        acceleration: Largest acceleration of the mover [m/s^2].
    """
    from_rest = math.sqrt(2.0 * acceleration * distance)
    return from_rest if from_rest <= acceleration * span else distance / span + 0.5 * acceleration * span


@njit(inline="always")
def fixed_growth(t: float, growth: Any) -> float:
    """Return the distance by which what is fixed may be nearer after a time [s]: the robot's own deviation."""
    return growth.disturbance * t


@njit(inline="always")
def standing_growth(t: float, growth: Any) -> float:
    """Return the distance by which what is known to stand may be nearer after a time [s]."""
    moved = (growth.begun + 0.5 * growth.mover_acceleration * t) * t
    return growth.disturbance * t + min(moved, growth.mover_speed * t)


@njit(inline="always")
def moving_growth(t: float, growth: Any) -> float:
    """Return the distance by which any other echo may be nearer after a time [s]."""
    return (growth.disturbance + growth.mover_speed) * t
