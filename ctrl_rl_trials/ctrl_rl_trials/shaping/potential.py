"""Seconds to the goal, by the time to reach or by the distance: what progress is measured in."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, position_indices

Array = NDArray[np.float64]
_FLIGHT = 2.0
"""Speed that a distance is divided by where no command is a speed [m/s]."""


class DistanceInSeconds:
    """The straight way to the middle of the goal at the robot's largest speed."""

    def __init__(self, task: NavigationTask) -> None:
        names = task.system.build().state_names
        self._first, self._second = position_indices(names)
        self._goal = task.goal.region.position
        self._speed = max(map(abs, task.robot.commands["v"])) if "v" in task.robot.commands else _FLIGHT
        corners = [
            (x, y) for x in task.plane_bounds[names[self._first]] for y in task.plane_bounds[names[self._second]]
        ]
        self.longest = max(math.dist(corner, self._goal) for corner in corners) / self._speed

    def times(self, states: Array) -> Array:  # noqa: D102 - see Potential
        offset = states[:, [self._first, self._second]] - self._goal
        return np.hypot(offset[:, 0], offset[:, 1]) / self._speed
