"""The obstacles of a map, which never move."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from ctrl_rl_core.navigation import OCCUPIED, Transform
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]
Fixed = Callable[[Array], NDArray[np.bool_]]
"""Returns which positions (n, 2) [m] are occupied on a map (n,)."""

NEAR = 0.1
"""Maximum distance between an occupied cell and an echo of it [m]."""


class MapWalls:
    """Distinguishes echoes of mapped obstacles from all others."""

    def __init__(self, map_: OccupancyMap) -> None:
        self._map = map_
        self._near = _around(map_.cells == OCCUPIED, math.ceil(NEAR / map_.resolution))

    def fixed(self, there: Array, pose: Array) -> Fixed:
        """Return a function that returns which positions in the odometry frame are occupied on the map.

        Args:
            there: Pose of the robot on the map (3,) [m, m, rad].
            pose: Odometry pose at the same time (3,) [m, m, rad].
        """
        x, y, yaw = (Transform.planar(*there.tolist()) @ Transform.planar(*pose.tolist()).inverse()).pose.tolist()
        c, s = math.cos(yaw), math.sin(yaw)
        near = self._near

        def on_map(points: Array) -> NDArray[np.bool_]:
            rows, columns = self._map.world_to_cell(points @ np.array(((c, s), (-s, c))) + (x, y))
            inside = (rows >= 0) & (rows < near.shape[0]) & (columns >= 0) & (columns < near.shape[1])
            out = np.zeros(len(points), np.bool_)
            out[inside] = near[rows[inside], columns[inside]]
            return out

        return on_map


def _around(occupied: NDArray[np.bool_], cells: int) -> NDArray[np.bool_]:
    """Return which cells (rows, columns) have an occupied one within a square of this many cells to each side."""
    out = occupied
    for axis in (0, 1):
        before = np.pad(out, [(cells, cells) if each == axis else (0, 0) for each in (0, 1)])
        count = out.shape[axis]
        out = np.logical_or.reduce([before.take(range(k, k + count), axis) for k in range(2 * cells + 1)])
    return np.asarray(out)
