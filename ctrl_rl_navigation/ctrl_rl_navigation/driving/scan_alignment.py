"""Aligns a scan with the walls of the map: a door that is closed is told from its posts only by a precise pose."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]

_COARSE = (0.05, math.radians(1.5), 3, 6)
"""Steps of position [m] and heading [rad], and their numbers to each side: three standard deviations of a localiser."""
_FINE = (0.0125, math.radians(0.5), 2, 2)
_WIDE = 0.15
"""Distance from a wall at which an echo does not speak for a pose any more [m]."""
_PRIOR = 0.01
"""Share of echoes that a pose must explain in addition to be preferred, at 0.05 m and 3 degrees from the given one."""
_POSITION, _HEADING = 0.05, math.radians(3.0)
_EXPLAINED = 0.5
"""Least agreement of echoes and walls; below it the pose is kept, because map, pose or surroundings are others."""
_MOST, _LEAST = 120, 20
"""Number of echoes used, and needed."""
_FARTHEST = 8.0
"""Distance of the echoes used [m]."""


@cached_njit
def _agreement(clearance: Any, x: float, y: float, theta: float, points: Array, wide: float) -> float:
    """Return how near echoes (n, 2) are to walls, 0 to 1, from a pose in cells."""
    c, s = math.cos(theta), math.sin(theta)
    height, width = clearance.shape
    total = 0.0
    for i in range(len(points)):
        column = round(x + c * points[i, 0] - s * points[i, 1])
        row = round(y + s * points[i, 0] + c * points[i, 1])
        if 0 <= row < height and 0 <= column < width and clearance[row, column] < wide:
            total += 1.0 - clearance[row, column] / wide
    return total / len(points)


@cached_njit
def _search(clearance: Any, given: Array, start: Array, points: Array, wide: float, steps: Any, prior: Any) -> Any:
    """Return the best pose in cells around a start (x, y, theta), and its agreement less its distance from `given`."""
    shift, turn, shifts, turns = steps
    best, out = -np.inf, (start[0], start[1], start[2])
    for k in range(-turns, turns + 1):
        theta = start[2] + k * turn
        for i in range(-shifts, shifts + 1):
            for j in range(-shifts, shifts + 1):
                x, y = start[0] + i * shift, start[1] + j * shift
                away = ((x - given[0]) ** 2 + (y - given[1]) ** 2) / prior[0] ** 2
                away += ((theta - given[2]) / prior[1]) ** 2
                found = _agreement(clearance, x, y, theta, points, wide) - prior[2] * away
                if found > best:
                    best, out = found, (x, y, theta)
    return out, best


def align(map_: OccupancyMap, clearance: NDArray[np.float32], pose: Array, points: Array) -> tuple[Array, bool]:
    """Return the pose (3,) [m, m, rad] at which a scan fits the map's walls, and whether it does.

    Args:
        map_: The map.
        clearance: Distances of its cells to its obstacles (rows, columns) [m].
        pose: Pose of the robot at the scan, with the errors of a localiser (3,) [m, m, rad].
        points: Echoes in the robot's frame (n, 2) [m].
    """
    near = points[np.hypot(points[:, 0], points[:, 1]) < _FARTHEST]
    if len(near) < _LEAST:
        return pose, False
    cell = map_.resolution
    used = np.ascontiguousarray(near[:: math.ceil(len(near) / _MOST)] / cell)
    row, column = map_.to_grid(pose[:2]).tolist()
    given = np.array((column, row, pose[2] - map_.origin[2]))
    prior, found, best = (_POSITION / cell, _HEADING, _PRIOR), given, -math.inf
    for shift, turn, shifts, turns in (_COARSE, _FINE):
        steps = (shift / cell, turn, shifts, turns)
        found, best = _search(clearance, given, np.array(found), used, _WIDE, steps, prior)
    if best < _EXPLAINED:
        return pose, False
    place = map_.cell_to_world(np.array([found[1]]), np.array([found[0]]))[0]
    return np.array((*place, found[2] + map_.origin[2])), True
