"""Rays through the cells of an occupancy map: a building has too many walls to look at each of them for each ray."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.navigation import OCCUPIED
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]


@cached_njit
def _march(occupied: Any, origins: Any, bearings: Any, reach: float, out: Any) -> None:
    """Write the ranges (N, beams) in cells, infinite where nothing is hit; origins x, y, heading (N, 3) in cells."""
    rows, columns = occupied.shape
    for scan in range(len(origins)):
        for beam in range(len(bearings)):
            angle = origins[scan, 2] + bearings[beam]
            dx, dy = math.cos(angle), math.sin(angle)
            out[scan, beam] = np.inf
            for step in range(int(2.0 * reach)):
                far = 0.5 * step
                row = math.floor(origins[scan, 1] + far * dy)
                column = math.floor(origins[scan, 0] + far * dx)
                if 0 <= row < rows and 0 <= column < columns and occupied[row, column]:
                    out[scan, beam] = max(far - 0.25, 0.0)  # the edge lies within the last half cell
                    break


def map_ranges(place: OccupancyMap, lidars: Array, bearings: Array, reach: float) -> Array:
    """Return the ranges (N, beams) [m] to occupied cells, to half a cell, +inf where there are none in reach.

    Args:
        place: Map.
        lidars: Poses of the lidars x, y, theta (N, 3) [m, m, rad].
        bearings: Bearings of the beams (beams,) [rad].
        reach: Length of a ray [m].
    """
    rows, columns = (place.to_grid(lidars[:, :2]) + 0.5).T
    origins = np.stack((columns, rows, lidars[:, 2] - place.origin[2]), axis=1)
    out = np.empty((len(lidars), len(bearings)))
    _march(place.cells == OCCUPIED, origins, bearings, reach / place.resolution, out)
    return out * place.resolution
