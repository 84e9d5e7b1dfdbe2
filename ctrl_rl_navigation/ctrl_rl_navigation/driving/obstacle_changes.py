"""Whether obstacles have changed so much since a value was solved that another one is needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

_SAME = 0.15
"""Maximum distance between two echoes of one obstacle, given the pose error [m]."""
_FADED, _OPENED = 0.3, 0.3
"""Fraction and length [m] of a value's obstacles; if more have disappeared, there may be a shorter way."""
_INTO = 1.5
"""Depth by which obstacles may lie within the robot's room beside its path [cells]."""


def on_the_way(points: Array, path: Array, room: float, cell: float) -> bool:
    """Return whether an obstacle lies on a path.

    Args:
        points: Obstacles (n, 2) [m].
        path: Positions along the path, half a cell apart (m, 2) [m].
        room: Minimum distance of the robot's centre from obstacles [m].
        cell: Side length of a map cell [m].
    """
    if not len(points) or len(path) < 2:
        return False
    return bool((_distances(points, path[:: max(1, int(room / cell))]) < room - _INTO * cell).any())


def have_gone(known: Array, points: Array, cell: float) -> bool:
    """Return whether enough obstacles that a value knows have disappeared.

    Args:
        known: Obstacles that the value knows (n, 2) [m].
        points: Present obstacles (m, 2) [m].
        cell: Side length of a map cell [m].
    """
    if not len(known) or not len(points):
        return len(known) > 0
    gone = _distances(known, points) > _SAME
    return bool(gone.mean() > _FADED or gone.sum() * cell > _OPENED)


def _distances(points: Array, others: Array) -> Array:
    """Return the distance from each point (n, 2) to the nearest of the others (m, 2) (n,) [m]."""
    return np.asarray(cKDTree(others).query(points)[0])
