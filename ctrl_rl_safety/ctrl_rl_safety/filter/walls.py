"""Identifies walls: surfaces larger than any mover, which therefore never move.

A surface is a chain of neighbouring static echoes without gaps and sharp bends, so a person leaning on a wall is not
part of it. No two points of a mover are farther apart than its maximum extent, so a larger surface is not a mover. A
wall that is later seen only in part is remembered for a while.
"""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_safety.filter.echoes import SAME, near_any

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LINK = 0.15
"""Maximum distance between neighbours on one wall [m], less than from a person's side to the wall."""
_ARM = 0.15
"""Straight distance to both sides of a bend [m]; noise of 1 cm changes the angle by 7 degrees. Measured along dense
echoes, the distance would be shorter, because noise lengthens that path.
"""
_BEND = math.radians(45.0)
"""Minimum angle of a bend that ends a surface."""
_SPAN = 5.0
"""Time for which a wall is remembered [s], limited because odometry drifts."""
_PART = 0.5
"""Extent of a surface's remembered part, relative to a mover's size, above which the whole surface is that wall."""


class Walls:
    """Walls seen recently, in a fixed frame.

    Args:
        size: Maximum extent of a mover [m].
    """

    def __init__(self, size: float) -> None:
        self._size = size
        self._places: Array = np.empty((0, 2))
        self._times: Array = np.empty(0)

    def update(self, now: float, points: Array, known: Flags) -> Flags:
        """Add a scan at a steady time [s] and return which of its echoes belong to walls (n,).

        Args:
            now: Steady time [s].
            points: Echoes in beam order (n, 2) [m].
            known: Whether each echo is static (n,).
        """
        fresh = now - self._times <= _SPAN
        self._places, self._times = self._places[fresh], self._times[fresh]
        there = known & near_any(points, self._places, SAME)
        wall = np.zeros(len(points), np.bool_)
        for part in surfaces_of(points, known):
            remembered = points[part[there[part]]]
            wall[part] = _extent(points[part]) > self._size or _extent(remembered) > _PART * self._size
        # An echo merely close to a remembered point does not renew it, so a mover cannot shift the wall gradually.
        gone = near_any(self._places, points[wall], 0.5 * SAME)
        self._places = np.concatenate((self._places[~gone], points[wall]))
        self._times = np.concatenate((self._times[~gone], np.full(int(wall.sum()), now)))
        return wall | there

    def clear(self) -> None:
        """Discard all walls, because the frame has jumped."""
        self._places, self._times = np.empty((0, 2)), np.empty(0)


def surfaces_of(points: Array, known: Flags) -> list[NDArray[np.intp]]:
    """Return the surfaces of a scan as arrays of echo indices in beam order.

    Args:
        points: Echoes in beam order (n, 2) [m].
        known: Whether each echo is static (n,).
    """
    count = len(points)
    if count < 2:
        return []
    gaps = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    linked = known & np.roll(known, -1) & (gaps < _LINK)
    order = (np.arange(count) + int(np.argmin(linked)) + 1) % count  # starts after a gap, if there is one
    linked = linked[order][:-1]
    bent = _bends(points[order], linked, _ARM, _BEND)
    linked &= ~(bent[:-1] | bent[1:])
    return [part for part in np.split(order, np.flatnonzero(~linked) + 1) if len(part) > 1]


@cached_njit
def _bends(points: Array, linked: Flags, arm: float, bend: float) -> Flags:
    """Return which points of surfaces lie at a sharp bend (n,).

    Args:
        points: Echoes in beam order (n, 2) [m].
        linked: Whether each echo is linked with the next one (n - 1,).
        arm: Distance to both sides over which a bend is measured [m].
        bend: Angle of a sharp bend [rad].
    """
    out = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i]
        a = b = i
        while a > 0 and linked[a - 1] and math.hypot(points[a, 0] - x, points[a, 1] - y) < arm:
            a -= 1
        while b < len(linked) and linked[b] and math.hypot(points[b, 0] - x, points[b, 1] - y) < arm:
            b += 1
        ax, ay, bx, by = x - points[a, 0], y - points[a, 1], points[b, 0] - x, points[b, 1] - y
        if math.hypot(ax, ay) >= arm and math.hypot(bx, by) >= arm:
            out[i] = abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by)) > bend
    return out


def _extent(points: Array) -> float:
    """Return the maximum distance of a point from the first one [m]."""
    return float(np.hypot(*(points - points[0]).T).max()) if len(points) else 0.0
