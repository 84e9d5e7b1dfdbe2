"""How a robot moved by its scans alone: the turn or shift that brings the echoes of two scans together.

Brute force over a few candidates: mounting faults are large, and no start value may lead astray.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ctrl_rl_bringup.preflight.recording import Points

_FARTHEST = 0.3
"""Distance at which an echo without a counterpart counts [m]."""
_MOST = 250
"""Echoes of the second scan that are looked up, spread evenly; more tell no more."""
Array = NDArray[np.float64]


def turn_mismatches(before: Points, after: Points, turns: Array) -> Array:
    """Return the mean distance (n,) [m] between the echoes, if the robot had turned by `turns` (n,) [rad] between.

    Args:
        before: Echoes in the robot's frame before the turn (m, 2) [m].
        after: Echoes after it (k, 2) [m].
        turns: Turns to try (n,), counter-clockwise [rad].
    """
    c, s = np.cos(turns), np.sin(turns)
    x, y = _thinned(after).T
    moved = np.stack((np.outer(c, x) - np.outer(s, y), np.outer(s, x) + np.outer(c, y)), axis=-1)
    return _mismatches(before, moved)


def shift_mismatches(before: Points, after: Points, shifts: Points) -> Array:
    """Return the mean distance (n,) [m] between the echoes, if the robot had moved by `shifts` (n, 2) [m] between.

    Args:
        before: Echoes in the robot's frame before the move (m, 2) [m].
        after: Echoes after it (k, 2) [m].
        shifts: Moves to try, in the robot's frame (n, 2) [m].
    """
    return _mismatches(before, _thinned(after)[None, :, :] + shifts[:, None, :])


def _thinned(points: Points) -> Points:
    return points[:: len(points) // _MOST + 1]


def _mismatches(before: Points, moved: NDArray[np.float64]) -> Array:
    """Return the mean distance (n,) [m] from each set of echoes (n, k, 2) to the nearest ones before (m, 2)."""
    distance, _ = KDTree(before).query(moved, distance_upper_bound=_FARTHEST)
    return np.asarray(np.minimum(distance, _FARTHEST).mean(axis=1))
