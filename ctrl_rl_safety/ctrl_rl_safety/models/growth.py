"""Bounds on the approach of obstacles over time, depending on what is known of them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import njit


class Growth(NamedTuple):
    """Motion bounds: the robot's deviation from its model, and the motion of obstacles.

    Fixed obstacles, such as walls, never move. An echo that has persisted counts as static: it may have started to move
    unnoticed, and may then accelerate by `mover_acceleration`. Any other echo may approach at `mover_speed`.

    Attributes:
        disturbance: Bound of the position's deviation per second of motion [m/s].
        mover_speed: Maximum speed of movers [m/s]; 0 for a static world.
        mover_acceleration: Maximum acceleration of static obstacles that start to move [m/s^2].
        begun: Maximum speed of obstacles that count as static, see `unnoticed_speed` [m/s].
    """

    disturbance: float
    mover_speed: float = 0.0
    mover_acceleration: float = 0.0
    begun: float = 0.0


def unnoticed_speed(distance: float, span: float, acceleration: float) -> float:
    """Return the maximum speed of a mover that has so far stayed within a distance [m/s].

    Args:
        distance: Distance within which motion goes unnoticed [m].
        span: Time for which the mover stayed there [s].
        acceleration: Maximum acceleration of the mover [m/s^2].
    """
    from_rest = math.sqrt(2.0 * acceleration * distance)
    return from_rest if from_rest <= acceleration * span else distance / span + 0.5 * acceleration * span


@njit(inline="always")
def fixed_growth(t: float, growth: Any) -> float:
    """Return the distance by which fixed obstacles may be closer after a time [s]: the robot's own deviation."""
    return growth.disturbance * t


@njit(inline="always")
def standing_growth(t: float, growth: Any) -> float:
    """Return the distance by which static obstacles may be closer after a time [s]."""
    moved = (growth.begun + 0.5 * growth.mover_acceleration * t) * t
    return growth.disturbance * t + min(moved, growth.mover_speed * t)


@njit(inline="always")
def moving_growth(t: float, growth: Any) -> float:
    """Return the distance by which a possible mover may be closer after a time [s]."""
    return (growth.disturbance + growth.mover_speed) * t
