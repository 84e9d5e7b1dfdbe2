"""Random starts and goals on a map, with the minimum driving time between them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import MapSolver

_START_GAP = 0.1
"""Clearance of a start in addition to the robot's own need [m]."""
_FREE = 0


@dataclass(frozen=True)
class Trial:
    """One trial drive.

    Attributes:
        start: Start pose x, y, theta [m, m, rad].
        goal: Position of the goal [m].
        reachable: Whether a path to the goal exists on the map.
    """

    start: tuple[float, float, float]
    goal: tuple[float, float]
    reachable: bool


class GoalMaker:
    """Draws trials, and computes their best times.

    The best time is the time to reach at full speed everywhere, solved on the same map for the same robot size, plus
    the time to turn in place into the descent direction at the full rate. Accelerations are ignored.
    """

    def __init__(self, map_: OccupancyMap, limits: DriveLimits, tolerance: float) -> None:
        self._map, self._limits, self._tolerance = map_, limits, tolerance
        self._solver = MapSolver(map_, limits, slowest=1.0)

    def draw(self, random: np.random.Generator, count: int) -> Iterator[Trial]:
        """Yield trials: starts with some clearance, goals on any free cell of the map."""
        roomy = np.argwhere(self._solver.clearance >= self._limits.room + _START_GAP)
        free = np.argwhere(self._map.cells == _FREE)
        if not len(roomy):
            raise NavigationError("the map has no room for the robot")
        for _ in range(count):
            row, column = roomy[random.integers(len(roomy))]
            x, y = self._map.cell_to_world(row, column)
            start = (float(x), float(y), random.uniform(-math.pi, math.pi))
            goal = self._map.cell_to_world(*free[random.integers(len(free))])
            place = (float(goal[0]), float(goal[1]))
            yield Trial(start, place, math.isfinite(self.best_time(start, place)))

    def best_time(self, pose: ArrayLike, goal: tuple[float, float]) -> float:
        """Return the best time from a pose (3,) to a goal [s]; inf if there is no path."""
        try:
            value = self._solver.solve(goal, self._tolerance)
        except NavigationError:
            return math.inf
        x, y, theta = np.asarray(pose, np.float64)
        times, gradient = value.value_and_gradient((x, y))
        if not np.isfinite(times) or times <= 0.0:
            return float(times)
        down = math.atan2(-gradient[1], -gradient[0])
        return float(times) + abs(math.remainder(down - theta, 2.0 * math.pi)) / self._limits.turn_rate
