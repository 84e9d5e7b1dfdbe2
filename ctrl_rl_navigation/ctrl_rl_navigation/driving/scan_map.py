"""A map built from scans in the odometry frame; unseen space counts as free."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.navigation import FREE, OCCUPIED
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]

_HIT, _MISS = 3, 1
"""Weights of an echo in a cell, and of a beam through a cell."""
_MOST, _SOLID = 15, 3
"""Maximum weight of a cell, and minimum weight of an obstacle."""
_SHORT = 0.06
"""Length by which a beam is shortened before its echo [m], so that an obstacle seen at its edge is not eroded."""


@cached_njit
def _look(weights: Any, row: float, column: float, ends: Array, echoes: Any, short: float) -> None:
    """Lower the cells along beams from a position to their ends (n, 2), and raise those with an echo; in cells."""
    height, width = weights.shape
    for i in range(len(ends)):
        rise, run = ends[i, 0] - row, ends[i, 1] - column
        length = math.hypot(rise, run)
        last_row, last_column = -1, -1
        for k in range(1, int(length - short) + 1):
            r, c = round(row + rise * k / length), round(column + run * k / length)
            if (r == last_row and c == last_column) or r < 0 or c < 0 or r >= height or c >= width:
                continue
            last_row, last_column = r, c
            if weights[r, c] > 0:
                weights[r, c] -= _MISS
    for i in range(len(ends)):
        r, c = round(ends[i, 0]), round(ends[i, 1])
        if echoes[i] and 0 <= r < height and 0 <= c < width:
            weights[r, c] = min(weights[r, c] + _HIT, _MOST)


class ScanMap:
    """Cells with an obstacle, based on counts of beams that end in and pass through each cell."""

    def __init__(self, corners: Array, margin: float, resolution: float) -> None:
        """Cover a rectangle of unknown space.

        Args:
            corners: Points to be covered (n, 2) [m].
            margin: Margin around the points [m].
            resolution: Side length of a cell [m].
        """
        low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
        columns, rows = np.ceil((high - low) / resolution).astype(int).tolist()
        self._weights = np.zeros((rows, columns), np.int8)
        origin = (float(low[0]), float(low[1]), 0.0)
        self._geometry = OccupancyMap(np.zeros((rows, columns), np.int8), resolution, origin)

    def see(self, origin: Array, ends: Array, echoes: NDArray[np.bool_]) -> None:
        """Process a scan.

        Args:
            origin: Position of the lidar (2,) [m].
            ends: End points of the beams (n, 2) [m].
            echoes: Whether each beam hit something (n,); the others passed only through free space.
        """
        row, column = self._geometry.to_grid(origin).tolist()
        _look(self._weights, row, column, self._geometry.to_grid(ends), echoes, _SHORT / self._geometry.resolution)

    def occupancy(self) -> OccupancyMap:
        """Return the current map."""
        cells = np.where(self._weights >= _SOLID, OCCUPIED, FREE).astype(np.int8)
        return OccupancyMap(cells, self._geometry.resolution, self._geometry.origin)

    def points_near(self, place: Array, reach: float) -> Array:
        """Return the centres of cells with an obstacle (n, 2) [m] in a square around a position (2,) [m]."""
        resolution = self._geometry.resolution
        row, column = np.rint(self._geometry.to_grid(place)).astype(int).tolist()
        cells = math.ceil(reach / resolution)
        top, left = max(row - cells, 0), max(column - cells, 0)
        part = self._weights[top : max(row + cells + 1, 0), left : max(column + cells + 1, 0)]
        rows, columns = np.nonzero(part >= _SOLID)
        return self._geometry.cell_to_world(rows + top, columns + left)
