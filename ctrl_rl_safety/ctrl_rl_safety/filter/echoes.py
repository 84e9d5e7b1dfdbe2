"""Converts the echoes of a scan to surfaces, and determines which of them are static.

Two neighbouring echoes that are closer together than the robot is wide may belong to one surface: points are added
between them, so that the robot's disc cannot dip in between. An echo counts as static if every scan within a time span
has an echo near it; otherwise it is treated as part of a moving obstacle.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME = 0.06
"""Maximum distance between echoes of different scans from the same place [m]."""
_FEWEST = 3
_MOST_POINTS = 3000
_THIN = 0.01


def moved(points: Array, pose: Array) -> Array:
    """Transform points (n, 2) from a frame to the one in which its pose (3,) is given."""
    x, y, theta = (float(each) for each in pose)
    c, s = math.cos(theta), math.sin(theta)
    return points @ np.array(((c, s), (-s, c))) + (x, y)


def thinned(points: Array) -> Array:
    """Return at most `_MOST_POINTS` of the echoes, in beam order (n, 2) [m]."""
    if len(points) <= _MOST_POINTS:
        return points
    _, first = np.unique(np.floor(points / _THIN).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)][:: math.ceil(len(first) / _MOST_POINTS)]


def surfaces(points: Array, spacing: float, widest: float) -> tuple[Array, NDArray[np.intp], Array]:
    """Return echoes, interpolated points between neighbours, and points across wider gaps.

    Args:
        points: Echoes in beam order (n, 2) [m].
        spacing: Maximum spacing of the points on a surface [m].
        widest: Maximum distance between neighbours on one surface [m].

    Returns:
        Echoes followed by interpolated points (m, 2) [m], the index of the preceding echo for each interpolated point
        (m - n,), and points across gaps (k, 2) [m].
    """
    if len(points) < 2:
        return points, np.empty(0, np.intp), np.empty((0, 2))
    following = np.roll(points, -1, axis=0)
    gaps = np.hypot(*(following - points).T)
    joined = gaps < widest
    between, line = _between(points[joined], following[joined], gaps[joined], spacing)
    wide, _ = _between(points[~joined], following[~joined], gaps[~joined], widest)
    return np.concatenate((points, between)), np.flatnonzero(joined)[line], wide


def _between(begin: Array, end: Array, lengths: Array, spacing: float) -> tuple[Array, NDArray[np.intp]]:
    """Return points (m, 2) at most `spacing` apart on lines (n, 2) to (n, 2), without the ends, and their lines."""
    counts = np.minimum(np.ceil(lengths / spacing).astype(np.intp) - 1, 200)
    line = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    share = (place / (counts[line] + 1))[:, None]
    return begin[line] + share * (end[line] - begin[line]), line


@cached_njit
def near_any(points: Array, others: Array, distance: float) -> NDArray[np.bool_]:
    """Return whether each point (n, 2) lies within a distance [m] of any of `others` (m, 2) (n,)."""
    out = np.zeros(len(points), np.bool_)
    square, count, last = distance * distance, len(others), 0
    for i in range(len(points)):
        for k in range(count):
            j = (last + k) % count
            dx, dy = points[i, 0] - others[j, 0], points[i, 1] - others[j, 1]
            if dx * dx + dy * dy <= square:
                out[i], last = True, j
                break
    return out


class EchoMemory:
    """Recent scans in a fixed frame.

    Args:
        span: Time for which an echo must persist to count as static [s].
    """

    def __init__(self, span: float) -> None:
        self._span = span
        self._scans: deque[tuple[float, Array]] = deque(maxlen=200)

    def update(self, now: float, points: Array) -> NDArray[np.bool_]:
        """Add a scan at a steady time [s] and return which of its points (n, 2) are static (n,)."""
        while len(self._scans) > 1 and self._scans[1][0] <= now - self._span:
            self._scans.popleft()
        known = np.zeros(len(points), np.bool_)
        enough = bool(self._scans) and self._scans[0][0] <= now - self._span and len(self._scans) >= _FEWEST
        if enough:
            known[:] = True
            for _, before in self._scans:
                if len(before):
                    known[known] = near_any(points[known], before, SAME)
                else:
                    known[:] = False
        self._scans.append((now, points))
        return known

    def clear(self) -> None:
        """Discard all scans, because the frame has jumped."""
        self._scans.clear()
