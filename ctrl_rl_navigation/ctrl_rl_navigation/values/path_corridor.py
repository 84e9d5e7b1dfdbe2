"""The corridor around a path: how far each cell of a map is from the path."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]

_PIECE = 100
"""Number of positions of a path whose surroundings are treated at once, half a cell apart."""


def resample(path: Array, step: float) -> Array:
    """Return points (m, 2) at equal distances of at most `step` [m] along a path (n, 2), from its start to its end."""
    if len(path) < 2:
        return path
    along = np.concatenate(((0.0,), np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    places = np.linspace(0.0, along[-1], math.ceil(along[-1] / step) + 1)
    return np.column_stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)])


def distances_to_path(map_: OccupancyMap, path: Array, reach: float) -> NDArray[np.float32]:
    """Return the distances [m] of the cells from a path (n, 2) [m], to about half a cell; inf beyond `reach` [m]."""
    out = np.full(map_.cells.shape, np.inf, np.float32)
    cells = np.rint(map_.to_grid(resample(path, 0.5 * map_.resolution))).astype(int)
    border = math.ceil(reach / map_.resolution) + 1
    # Piece by piece: of a long path that turns, a single box would be most of the map, and delay the node's commands.
    for begin in range(0, len(cells), _PIECE):
        piece = cells[begin : begin + _PIECE]
        low = np.maximum(piece.min(axis=0) - border, 0)
        high = np.minimum(piece.max(axis=0) + border + 1, out.shape)
        inside = piece[((piece >= low) & (piece < high)).all(axis=1)] - low
        if len(inside):
            away = np.ones(high - low, bool)
            away[inside[:, 0], inside[:, 1]] = False
            distances = map_.resolution * distance_transform_edt(away)
            part = out[low[0] : high[0], low[1] : high[1]]
            np.minimum(part, np.where(distances <= reach, distances, np.inf), out=part, casting="unsafe")
    return out
