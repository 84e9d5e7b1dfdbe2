"""Which echoes are walls: they belong to something larger than any mover, which therefore never moves.

A surface is a chain of neighbouring echoes that are known to stand, without a gap and without a sharp bend: who leans
on a wall is no part of it. No two points of a body of some size are farther apart than that, so that a larger surface
belongs to none. A wall of which only a part is seen later is remembered for a while.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.filter.echoes import SAME, near_any

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LINK = 0.15
"""Distance of neighbours up to which they belong to one wall [m]: less than from the side of a person to the wall."""
_ARM = 0.15
"""Length of a surface to both sides of a bend [m]: noise of 1 cm bends it by 7 degrees."""
_BEND = math.radians(45.0)
"""Angle from which on a surface ends at a bend."""
_APART = 100.0
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
    points, linked, gaps = points[order], linked[order][:-1], gaps[order][:-1]
    along = np.concatenate(((0.0,), np.cumsum(np.where(linked, gaps, _APART))))
    before = np.searchsorted(along, along - _ARM, side="right") - 1
    after = np.minimum(np.searchsorted(along, along + _ARM), count - 1)
    whole = (before >= 0) & (along - along[before] < 0.5 * _APART)
    whole &= (along[after] - along >= _ARM) & (along[after] - along < 0.5 * _APART)
    (ax, ay), (bx, by) = (points - points[before]).T, (points[after] - points).T
    bent = whole & (np.abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by)) > _BEND)
    linked &= ~(bent[:-1] | bent[1:])
    return [part for part in np.split(order, np.flatnonzero(~linked) + 1) if len(part) > 1]


def _extent(points: Array) -> float:
    """Return the distance of the farthest point from the first one [m]."""
    return float(np.hypot(*(points - points[0]).T).max()) if len(points) else 0.0
