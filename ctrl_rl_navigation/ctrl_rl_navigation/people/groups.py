"""Groups of neighbouring echoes of a scan that are small enough to be a person, as discs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_GAP, _PER_METRE = 0.12, 0.03
"""Distance between neighbouring echoes that parts groups: fixed [m], and for each metre from the lidar."""
_LARGEST = 1.2
"""Maximum extent of a group [m]."""
_LEAST_ECHOES = 3
_FARTHEST = 8.0
"""Maximum distance of a group [m]."""
_RADII = (0.05, 0.6)
_NEIGHBOURS = 3
"""Number of beams up to which echoes are neighbours, since single beams may be lost."""
_IN_FRONT = 0.1
"""Distance by which what hides a group's edge is nearer [m]."""


class Disc(NamedTuple):
    """A group as a disc, of which the near side is seen.

    Attributes:
        origin: Position of the lidar (2,) [m].
        near: Distance of the near side from there [m].
        edges: Bearings of its two edges (2,) [rad].
        hidden: Whether something may hide more of the disc beyond either edge.
        radius: Radius, if nothing is hidden [m].
        echoes: Positions of its echoes (n, 2) [m].
        members: Indices of these among the scan's echoes (n,).
    """

    origin: Array
    near: float
    edges: tuple[float, float]
    hidden: tuple[bool, bool]
    radius: float
    echoes: Array
    members: NDArray[np.intp]

    @property
    def partly(self) -> bool:
        """Whether a part may be hidden."""
        return any(self.hidden)

    def centre(self, radius: float) -> Array:
        """Return the centre (2,) of a disc of some radius [m]: behind the middle, or beside the edge that is seen."""
        (low, high), (low_hidden, high_hidden) = self.edges, self.hidden
        bearing, half = 0.5 * (low + high), math.asin(radius / (self.near + radius))
        if low_hidden != high_hidden:
            bearing = min(bearing, high - half) if low_hidden else max(bearing, low + half)
        return self.origin + (self.near + radius) * np.array((math.cos(bearing), math.sin(bearing)))


def discs_of(origin: Array, ends: Array, echoes: NDArray[np.bool_], fresh: NDArray[np.bool_]) -> list[Disc]:
    """Return the small groups of a scan.

    Args:
        origin: Position of the lidar (2,) [m].
        ends: End points of the beams, in beam order (n, 2) [m].
        echoes: Whether each beam hit something (n,).
        fresh: Whether each echo is where nothing was some time ago, and thus no part of a wall (number of echoes,).
    """
    points, beams = ends[echoes], np.flatnonzero(echoes)
    if len(points) < _LEAST_ECHOES:
        return []
    ranges = np.hypot(*(points - origin).T)
    following = np.roll(np.arange(len(points)), -1)
    steps = np.hypot(*(points[following] - points).T)
    skipped = np.mod(beams[following] - beams, len(ends))
    if not _goes_around(origin, ends):
        skipped[-1] = len(ends)
    parts = steps > _GAP + _PER_METRE * np.minimum(ranges, ranges[following])
    parts |= skipped == len(ends)
    # Somebody beside a wall is a row of fresh echoes in it; single ones seem fresh, as beams are lost.
    apart = fresh & np.roll(fresh, 1) | fresh & np.roll(fresh, -1)
    large = np.zeros(len(points), np.bool_)
    for members in _runs(parts):
        large[members] = _extent(points[members]) > _LARGEST
    parts |= large & (apart != apart[following])
    out = []
    for members in _runs(parts):
        before, after = (members[0] - 1) % len(points), (members[-1] + 1) % len(points)
        if len(members) < _LEAST_ECHOES or ranges[members].min() > _FARTHEST or _extent(points[members]) > _LARGEST:
            continue
        low, high = (
            skipped[left] == len(ends)  # the edge of the field
            or (skipped[left] <= _NEIGHBOURS and ranges[beside] < ranges[edge] - _IN_FRONT)
            for left, beside, edge in ((before, before, members[0]), (members[-1], after, members[-1]))
        )
        out.append(_disc(origin, points[members], ranges[members], (bool(low), bool(high)), members))
    return out


def _runs(parts: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the indices of each group of a ring (k,), from whether the ring is parted after each element (n,)."""
    ends = np.flatnonzero(parts)
    if not len(ends):
        return [np.arange(len(parts))]
    order = np.mod(np.arange(len(parts)) + ends[0] + 1, len(parts))
    return np.split(order, np.flatnonzero(parts[order])[:-1] + 1)


def _extent(points: Array) -> float:
    return float(np.hypot(*np.ptp(points, axis=0)))


def _goes_around(origin: Array, ends: Array) -> bool:
    """Return whether the last beam of a scan is a neighbour of the first one."""
    (first_x, first_y), (last_x, last_y) = ends[0] - origin, ends[-1] - origin
    turn = math.atan2(first_y, first_x) - math.atan2(last_y, last_x)
    return abs(math.remainder(turn, 2.0 * math.pi)) < _NEIGHBOURS * 2.0 * math.pi / len(ends)


def _disc(origin: Array, points: Array, ranges: Array, hidden: tuple[bool, bool], members: NDArray[np.intp]) -> Disc:
    """Return the disc whose near side the echoes of a group are, in beam order."""
    x, y = (points - origin).T
    middle = math.atan2(float(y.sum()), float(x.sum()))
    off = np.mod(np.arctan2(y, x) - middle + math.pi, 2.0 * math.pi) - math.pi
    low, high = float(off.min()), float(off.max())
    if off[0] > off[-1]:  # beams go clockwise
        hidden = hidden[::-1]
    near = float(np.partition(ranges, 1)[1])  # the second nearest: the nearest is as far off as noise allows
    half = 0.5 * (high - low) * len(points) / (len(points) - 1)  # beams end half a beam beside the edge
    sine = min(math.sin(min(half, 0.5 * math.pi)), 0.9)
    radius = min(max(near * sine / (1.0 - sine), _RADII[0]), _RADII[1])
    return Disc(origin, near, (middle + low, middle + high), hidden, radius, points, members)
