"""A hybrid A*: arcs of a car from continuous poses, one pose kept for each cell of position and heading.

A plain implementation to compare with: arcs of one and a half cells, the greater of two lower bounds as heuristic (the
closed form without obstacles, and the way of a point among them), and no smoothing of the path.
"""

from __future__ import annotations

import heapq
import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_navigation.cars import CarLimits, fits, footprint_of
from numba import njit
from numpy.typing import NDArray

from cars.reeds_shepp import shortest
from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation import DriveLimits, MapSolver

HEADINGS = 72
_ARC = 1.5
"""Length of an arc [cells]."""
_STEPS = 3
"""Number of poses of an arc that are checked."""


class Plan(NamedTuple):
    """Result of a search.

    Attributes:
        seconds: Time of the path [s]; inf if none was found.
        expanded: Number of poses expanded.
    """

    seconds: float
    expanded: int


class HybridAStar:
    """Plans on one map for one car.

    Args:
        map_: The map.
        limits: Size and limits of the car.
        cell: Length of a cell [m].
        most: Number of poses after which a search gives up.
    """

    def __init__(self, map_: OccupancyMap, limits: CarLimits, cell: float, most: int = 3_000_000) -> None:
        self._map, self._limits, self._cell, self._most = map_, limits, cell, most
        self._field = np.minimum(map_.clearance() / np.float32(map_.resolution), np.float32(1e6))
        self._shape = footprint_of(limits.length, limits.width, limits.centre, limits.margin, map_.resolution)
        half = 0.5 * limits.width
        fastest = max(limits.speed, limits.reverse_speed)
        point = DriveLimits(fastest, 1.0, 1.0, 1.0, half, limits.margin)
        self._point = MapSolver(map_, point, slowest=1.0)

    def plan(
        self, start: NDArray[np.float64], goal: tuple[float, float], heading: float, tolerances: tuple[float, float]
    ) -> Plan:
        """Search a path to within a distance [m] and an angle [rad] of a goal pose."""
        limits, map_ = self._limits, self._map
        away = self._point.solve(goal, tolerances[0]).times.astype(np.float64)
        numbers = (
            limits.turning_radius,
            limits.speed,
            limits.reverse_speed,
            limits.change_time,
            self._cell,
            map_.resolution,
            *tolerances,
        )
        x, y, yaw = map_.origin
        assert yaw == 0.0
        first = (float(start[0]) - x, float(start[1]) - y, float(start[2]))
        last = (goal[0] - x, goal[1] - y, heading)
        return Plan(*_search(self._field, self._shape, away, numbers, first, last, self._most))


@njit(cache=True)
def _bound(away: Any, numbers: Any, pose: Any, goal: Any) -> float:
    """Return a lower bound of the time from a pose to the goal [s]."""
    radius, speed, reverse, _, _, resolution, near, turned = numbers
    fastest = max(speed, reverse)
    row, column = int(pose[1] / resolution), int(pose[0] / resolution)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = goal[0] - pose[0], goal[1] - pose[1]
    path = shortest((c * dx + s * dy) / radius, (c * dy - s * dx) / radius, goal[2] - pose[2]) * radius
    # The goal may be missed by its tolerances: at most their own way, and twice the turn.
    free = max(path - near - 4.0 * turned * radius, 0.0) / fastest
    return max(free, 0.95 * away[row, column])


@njit(cache=True)
def _search(field: Any, shape: Any, away: Any, numbers: Any, start: Any, goal: Any, most: int) -> tuple[float, int]:
    radius, speed, reverse, change, cell, resolution, near, turned = numbers
    rows, columns = int(field.shape[0] * resolution / cell) + 2, int(field.shape[1] * resolution / cell) + 2
    best = np.full((2, HEADINGS, rows, columns), np.inf, np.float32)
    done = np.zeros((2, HEADINGS, rows, columns), np.bool_)
    queue = [(_bound(away, numbers, start, goal), 0.0, gear, start[0], start[1], start[2]) for gear in range(2)]
    heapq.heapify(queue)
    expanded = 0
    while queue and expanded < most:
        _, time, gear, x, y, theta = heapq.heappop(queue)
        k = round(theta / (2.0 * math.pi) * HEADINGS) % HEADINGS
        i, j = round(y / cell), round(x / cell)
        if done[gear, k, i, j]:
            continue
        done[gear, k, i, j] = True
        expanded += 1
        error = (theta - goal[2] + math.pi) % (2.0 * math.pi) - math.pi
        if math.hypot(x - goal[0], y - goal[1]) <= near and abs(error) <= turned:
            return time, expanded
        for other in range(2):
            way = _ARC * cell if other == 0 else -_ARC * cell
            cost = time + abs(way) / (speed if other == 0 else reverse) + (change if other != gear else 0.0)
            for turn in (-1.0, 0.0, 1.0):
                free = True
                a, b, c = x, y, theta
                for _ in range(_STEPS):
                    half = 0.5 * way / _STEPS * turn / radius
                    chord = way / _STEPS
                    a += chord * math.cos(c + half)
                    b += chord * math.sin(c + half)
                    c += 2.0 * half
                    if not fits(field, b / resolution - 0.5, a / resolution - 0.5, c, shape):
                        free = False
                        break
                if not free:
                    continue
                h = round(c / (2.0 * math.pi) * HEADINGS) % HEADINGS
                r, q = round(b / cell), round(a / cell)
                if done[other, h, r, q] or cost >= best[other, h, r, q]:
                    continue
                bound = _bound(away, numbers, (a, b, c), goal)
                if bound < np.inf:
                    best[other, h, r, q] = cost
                    heapq.heappush(queue, (cost + bound, cost, other, a, b, c))
    return np.inf, expanded
