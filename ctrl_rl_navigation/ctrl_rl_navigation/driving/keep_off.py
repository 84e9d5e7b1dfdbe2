"""A distance from somebody who stands on the goal: people do not set out past a robot that waits close by."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_navigation.people import NOBODY, mover

Array = NDArray[np.float64]

BESIDE, PAUSE = 0.8, 10.0
"""Distance from the goal within which a robot that gets no nearer makes room [m], and for how long [s]."""
_COVERS = 0.6
"""Distance from the goal of what covers it [m]."""
_OFF = 1.2
"""Distance from what covers the goal at which the robot waits [m]."""
_INTO = 0.1
"""Depth by which the robot is in the place that it shall leave [m]."""
_SOON = 1.0
"""Time that it has to leave [s]: being there is no contact."""


def to_leave(goal: tuple[float, float], obstacles: Array, place: Array, room: float) -> Array:
    """Return a mover (1, 12), see `people.movers`, that stands for what covers a goal and just reaches the robot.

    A disc of the full distance would be no cheaper to leave than to stay in, where the way out takes long.

    Args:
        goal: Position of the goal [m].
        obstacles: Unmapped obstacles (n, 2) [m].
        place: Position of the robot (2,) [m].
        room: Distance of the robot's centre from what it touches [m].

    Returns:
        That mover; none (0, 12) where nothing covers the goal or the robot is far enough away.
    """
    covers = obstacles[np.hypot(*(obstacles - goal).T) < _COVERS]
    away = math.dist(covers.mean(axis=0), place) if len(covers) else math.inf
    if away > _OFF:
        return NOBODY
    radius = max(min(away + _INTO, _OFF) - room, _INTO)
    return mover(covers.mean(axis=0), np.zeros(2), radius, (_INTO**2, 0.0, 0.0), begin=_SOON, acceleration=0.0)[None]
