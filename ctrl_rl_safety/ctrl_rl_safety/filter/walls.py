"""Which echoes are walls: they belong to something larger than any mover, which therefore never moves.

A surface is a chain of neighbouring echoes that are known to stand, without a gap and without a sharp bend: who leans
on a wall is no part of it. No two points of a body of some size are farther apart than that, so that a larger surface
belongs to none. A wall of which only a part is seen later is remembered for a while.
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
"""Distance of neighbours up to which they belong to one wall [m]: less than from the side of a person to the wall."""
_ARM = 0.15
"""Straight distance to both sides of a bend [m]: noise of 1 cm bends it by 7 degrees. Along the echoes it would be less
where these are dense, as noise lengthens that way."""
_BEND = math.radians(45.0)
"""Angle from which on a surface ends at a bend."""
_SPAN = 5.0
"""Time for which a wall is remembered [s]: odometry drifts."""
_PART = 0.5
"""Extent of the remembered part of a surface over the size of a mover, from which on all of it is that wall."""


class Walls:
    """The walls seen in the last while, in a frame that stands still.

    Args:
        size: Largest extent of a mover [m].
    """

    def __init__(self, size: float) -> None:
        self._size = size
        self._places: Array = np.empty((0, 2))
        self._times: Array = np.empty(0)

    def update(self, now: float, points: Array, known: Flags) -> Flags:
        """Take a scan at a steady time [s] and return which of its echoes are of walls (n,).

        Args:
            now: Steady time [s].
            points: Echoes in the order of their beams (n, 2) [m].
            known: Flags of those that are known to stand (n,).
        """
        fresh = now - self._times <= _SPAN
        self._places, self._times = self._places[fresh], self._times[fresh]
        there = known & near_any(points, self._places, SAME)
        wall = np.zeros(len(points), np.bool_)
        for part in surfaces_of(points, known):
            remembered = points[part[there[part]]]
            wall[part] = _extent(points[part]) > self._size or _extent(remembered) > _PART * self._size
        # What only lies near a remembered place does not renew it: so no mover takes it away step by step.
        gone = near_any(self._places, points[wall], 0.5 * SAME)
        self._places = np.concatenate((self._places[~gone], points[wall]))
        self._times = np.concatenate((self._times[~gone], np.full(int(wall.sum()), now)))
        return wall | there

    def clear(self) -> None:
        """Forget all walls, as the frame has jumped."""
        self._places, self._times = np.empty((0, 2)), np.empty(0)


def surfaces_of(points: Array, known: Flags) -> list[NDArray[np.intp]]:
    """Return the surfaces of a scan as numbers of their echoes, each in the order of their beams.

    Args:
        points: Echoes in the order of their beams (n, 2) [m].
        known: Flags of those that are known to stand (n,).
    """
    count = len(points)
    if count < 2:
        return []
    gaps = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    linked = known & np.roll(known, -1) & (gaps < _LINK)
    order = (np.arange(count) + int(np.argmin(linked)) + 1) % count  # from behind a gap on, where there is one
    linked = linked[order][:-1]
    bent = _bends(points[order], linked, _ARM, _BEND)
    linked &= ~(bent[:-1] | bent[1:])
    return [part for part in np.split(order, np.flatnonzero(~linked) + 1) if len(part) > 1]


@cached_njit
def _bends(points: Array, linked: Flags, arm: float, bend: float) -> Flags:
    """Return which places of surfaces lie at a sharp bend (n,).

    Args:
        points: Echoes in the order of their beams (n, 2) [m].
        linked: Flags of those that belong together with the one after them (n - 1,).
        arm: Distance to both sides over which a surface may bend [m].
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
    """Return the distance of the farthest point from the first one [m]."""
    return float(np.hypot(*(points - points[0]).T).max()) if len(points) else 0.0
