"""Evidence of free space: a place where an echo was stays occupied until enough beams have passed through it.

A lidar misses things: a thin pole, a dark leg, a beam that gets lost. So one scan without an echo is weak evidence of
free space. If a scan misses what its beams hit with probability p, then k scans in a row miss it with probability p^k.
An echo is forgotten once p^k is small, when a new echo takes its place, or when odometry may have drifted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.sensing import measured
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from ctrl_rl_safety.models.robot_model import RobotModel

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOVING, STANDING, FIXED = 0, 1, 2
"""What is known of an echo: it may move, it has stood so far, or it never moves."""
WRONGLY = 1e-5
"""Maximum probability that k passes in a row miss something that is there."""
THINNEST = 0.02
"""Minimum width of what no two beams may straddle unnoticed [m]."""
_ASIDE = 0.01
"""Maximum distance across a beam at which its echo replaces an older one [m]."""
_ROUNDING = 0.01
"""Difference of ranges beyond the errors of both echoes, for slanted surfaces [m]."""
_LINK = 0.15
"""Maximum distance of neighbours on one surface [m]."""
_WIDEST = 0.1
"""Maximum width that a surface is assumed to have from every side [m]."""
_LONGEST, _FARTHEST = 10.0, 3.0
"""Time [s] and path length [m] after which an echo is forgotten anyway, because odometry drifts."""
_MOST = 1000
"""Maximum number of echoes kept beyond those of the last scan."""
_FILL = math.radians(0.25)
"""Spacing of the beams assumed in gaps between echoes where a caller gives no beams [rad]."""


class Beams(NamedTuple):
    """The beams of a scan, with and without echo.

    Attributes:
        ends: Echo of each beam, or any position in its direction, in the robot's frame (n, 2) [m].
        returned: Whether each beam has an echo (n,).
        nearest: Minimum measured distance [m]; nearer places are never looked at.
        forward: Position of the lidar ahead of the robot's centre [m].
    """

    ends: Array
    returned: Flags
    nearest: float
    forward: float


class Held(NamedTuple):
    """Echoes that the last scan neither shows nor refutes.

    Attributes:
        places: Positions in the odometry frame (n, 2) [m].
        kinds: One of MOVING, STANDING and FIXED each, when last seen (n,).
        ages: Times since they were last seen (n,) [s].
    """

    places: Array
    kinds: NDArray[np.int8]
    ages: Array

    def beside(
        self, others: tuple[Array, Array, Array], fresh: Array, mover_speed: float, same: float
    ) -> tuple[Array, Array, Array]:
        """Return fixed, standing and moving positions (n, 2) each [m]: others, then these.

        What may have gone to where a new echo is has left its place: that stays occupied, but nothing comes from it.

        Args:
            others: Fixed, standing and moving positions (n, 2) each [m].
            fresh: Echoes of the last scan, in the same frame (k, 2) [m].
            mover_speed: Maximum speed of movers [m/s].
            same: Distance up to which two echoes may be of one place [m].
        """
        kinds = self.kinds
        if mover_speed > 0.0:
            there = nearest_distance(self.places, fresh) <= mover_speed * self.ages + same
            kinds = np.where(there, FIXED, kinds)
        fixed, standing, moving = others
        return (
            np.concatenate((fixed, self.places[kinds == FIXED])),
            np.concatenate((standing, self.places[kinds == STANDING])),
            np.concatenate((moving, self.places[kinds == MOVING])),
        )


def beams_of(ranges: NDArray[np.float32], scan: ScanGeometry, forward: float) -> Beams:
    """Return the beams of a scan; a beam that measured nothing counts as one without an echo.

    Args:
        ranges: Ranges (scan.beams,) [m].
        scan: Bearings and limits of the beams in the robot's frame.
        forward: Position of the lidar ahead of the robot's centre [m].
    """
    distances = measured(ranges, scan)
    returned = np.isfinite(distances)
    bearings = scan.angle_min + scan.angle_increment * np.arange(scan.beams, dtype=np.float64)
    return beams_at(bearings, np.where(returned, distances, np.inf), forward, scan.range_min)


def beams_at(bearings: Array, ranges: Array, forward: float = 0.0, nearest: float = 0.0) -> Beams:
    """Return beams from their bearings (n,) [rad] and ranges (n,) [m], where a range that is not finite is no echo."""
    returned = np.isfinite(ranges)
    far = np.where(returned, ranges, 1.0 + nearest)
    ends = np.column_stack((forward + far * np.cos(bearings), far * np.sin(bearings)))
    return Beams(ends, returned, nearest, forward)


def beams_from(echoes: Array, widest: float) -> Beams:
    """Return beams assumed where only echoes (n, 2) in the robot's frame are given [m]: dense, and all around.

    Between neighbours closer together than `widest` [m] there is a surface, and so no beam without an echo.
    """
    bearings = np.arctan2(echoes[:, 1], echoes[:, 0])
    order = np.argsort(bearings)
    bearings, ends = bearings[order], echoes[order]
    filling = np.arange(-math.pi, math.pi, _FILL)
    if len(echoes) > 1:
        right = np.searchsorted(bearings, filling) % len(bearings)
        apart = np.hypot(*(ends[right] - ends[right - 1]).T) >= widest
        apart |= np.mod(bearings[right] - bearings[right - 1], 2.0 * math.pi) > 0.5 * math.pi  # the way round
        filling = filling[apart]
    empty = np.column_stack((np.cos(filling), np.sin(filling)))
    returned = np.concatenate((np.ones(len(ends), np.bool_), np.zeros(len(empty), np.bool_)))
    return Beams(np.concatenate((ends, empty)), returned, 0.0, 0.0)


def kinds_of(known: Flags, stays: Flags) -> NDArray[np.int8]:
    """Return the kinds of echoes from whether they have stood so far (n,), and whether they never move (n,)."""
    return np.where(stays, FIXED, np.where(known, STANDING, MOVING)).astype(np.int8)


def passes_needed(missing_rate: float) -> int:
    """Return the number of passes in a row after which an echo is forgotten; 0 for a lidar that misses nothing."""
    return 0 if missing_rate <= 0.0 else max(1, math.ceil(math.log(WRONGLY) / math.log(missing_rate) - 1e-9))


class EchoEvidence:
    """Echoes seen recently, in a fixed frame, until they are seen gone.

    Args:
        model: The robot, whose lidar has a rate of missing and errors of its ranges.
        reach: Distance from the robot within which echoes are kept [m].

    Attributes:
        awaited: Number of scans without which too little is known.
    """

    def __init__(self, model: RobotModel, reach: float) -> None:
        self._enough, self._same = passes_needed(model.missing_rate), 2.0 * model.range_error + _ROUNDING
        self._core, self._radius, self._reach = model.core, model.radius, reach
        self._widest = 2.0 * model.half_width
        self.clear()
        self.awaited = 0

    def clear(self) -> None:
        """Discard all echoes, because the frame has jumped: as many scans as may miss a thing in a row are awaited."""
        self.awaited = self._enough
        self._places: Array = np.empty((0, 2))
        self._widths, self._times, self._ways = np.empty(0), np.empty(0), np.empty(0)
        self._passes, self._kinds = np.empty(0, np.intp), np.empty(0, np.int8)
        self._way, self._last = 0.0, np.full(2, math.nan)

    def look(self, now: float, pose: Array, beams: Beams) -> Held:
        """Weigh a scan, and return the echoes of earlier scans that still stand.

        Args:
            now: Steady time [s].
            pose: Pose of the robot at the time of the scan, in the fixed frame (3,) [m, m, rad].
            beams: Beams of the scan.
        """
        if np.isfinite(self._last).all():
            self._way += math.dist(self._last.tolist(), pose[:2].tolist())
        self._last = pose[:2].copy()
        c, s = math.cos(pose[2]), math.sin(pose[2])
        points = (self._places - pose[:2]) @ np.array(((c, -s), (s, c)))
        away = np.hypot(*points.T)
        fresh = (now - self._times <= _LONGEST) & (self._way - self._ways <= _FARTHEST) & (away < self._reach)
        fresh &= ~self._below(points)
        if len(beams.ends):
            replaced, passed = _judge(points, self._widths, beams, self._same, self._widest)
            self._passes[passed] += 1
            fresh &= ~replaced & (self._passes < self._enough)
        kept = np.flatnonzero(fresh)
        if len(kept) > _MOST:
            kept = np.sort(kept[np.argsort(away[kept])[:_MOST]])
        self._keep(kept)
        return Held(self._places, self._kinds, now - self._times)

    def note(self, now: float, places: Array, kinds: NDArray[np.int8]) -> None:
        """Add the echoes of the scan that was just weighed.

        Args:
            now: Steady time [s].
            places: Positions in the fixed frame, in beam order (n, 2) [m].
            kinds: One of MOVING, STANDING and FIXED each (n,).
        """
        count, self.awaited = len(places), max(self.awaited - 1, 0)
        self._places = np.concatenate((self._places, places))
        self._widths = np.concatenate((self._widths, widths(places)))
        self._times = np.concatenate((self._times, np.full(count, now)))
        self._ways = np.concatenate((self._ways, np.full(count, self._way)))
        self._passes = np.concatenate((self._passes, np.zeros(count, np.intp)))
        self._kinds = np.concatenate((self._kinds, kinds))

    def _keep(self, kept: NDArray[np.intp]) -> None:
        self._places, self._widths, self._times = self._places[kept], self._widths[kept], self._times[kept]
        self._ways, self._passes, self._kinds = self._ways[kept], self._passes[kept], self._kinds[kept]

    def _below(self, points: Array) -> Flags:
        """Return which points (n, 2) in the robot's frame lie well inside of it, and so cannot be occupied (n,)."""
        if self._core[0] > 0.0:
            return np.asarray((np.abs(points) < np.array(self._core) - self._same).all(axis=1))
        return np.hypot(*points.T) < self._radius - self._same


def widths(points: Array) -> Array:
    """Return the width that each echo's thing has at least (n,) [m].

    Three echoes in a row belong to a surface, which reaches at least to its neighbours. Anything else may be as thin as
    `THINNEST`.

    Args:
        points: Echoes in beam order (n, 2) [m].
    """
    out = np.full(len(points), THINNEST)
    if len(points) < 3:
        return out
    gaps = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    linked = gaps < _LINK
    linked &= np.roll(linked, 1) | np.roll(linked, -1)
    wide = np.where(linked, gaps, 0.0)
    return np.asarray(np.clip(np.maximum(wide, np.roll(wide, 1)), THINNEST, _WIDEST))


def _judge(points: Array, wide: Array, beams: Beams, same: float, widest: float) -> tuple[Flags, Flags]:
    """Return which earlier echoes are replaced by those of a scan, and through which its beams have passed (n,) each.

    A thing that is there and as wide as stated is hit by one of the two beams beside the echo if these are no farther
    apart than it is wide. So a pass needs both beams to go beyond the echo, and to be so near to each other.

    Args:
        points: Earlier echoes in the robot's frame (n, 2) [m].
        wide: Minimum widths of what they belong to (n,) [m].
        beams: Beams of the scan.
        same: Maximum distance along a beam between two echoes of one place [m].
        widest: Maximum distance between neighbours on one surface [m].
    """
    lidar = np.array((beams.forward, 0.0))
    ends = beams.ends - lidar
    bearings = np.arctan2(ends[:, 1], ends[:, 0])
    order = np.argsort(bearings)
    bearings, ends, returned = bearings[order], ends[order], beams.returned[order]
    ranges = np.where(returned, np.hypot(*ends.T), np.inf)
    seen = points - lidar
    at, away = np.arctan2(seen[:, 1], seen[:, 0]), np.hypot(*seen.T)
    right = np.searchsorted(bearings, at) % len(bearings)
    left = right - 1
    gap = np.mod(bearings[right] - bearings[left], 2.0 * math.pi) if len(bearings) > 1 else np.full(len(at), math.pi)
    passed = (np.minimum(ranges[left], ranges[right]) > away + same) & (away >= beams.nearest) & (gap * away <= wide)
    replaced = np.zeros(len(points), np.bool_)
    for side in (left, right):
        aside = np.abs(np.remainder(at - bearings[side] + math.pi, 2.0 * math.pi) - math.pi) * away
        replaced |= returned[side] & (np.abs(ranges[side] - away) <= same) & (aside <= _ASIDE)
    begin, along = ends[left], ends[right] - ends[left]
    length = np.hypot(*along.T)
    share = np.clip(((seen - begin) * along).sum(axis=1) / np.maximum(length, 1e-9) ** 2, 0.0, 1.0)
    off = np.hypot(*(seen - begin - share[:, None] * along).T)
    replaced |= returned[left] & returned[right] & (length < widest) & (off <= same)
    return replaced, passed


@cached_njit
def nearest_distance(points: Array, others: Array) -> Array:
    """Return the distance of each point (n, 2) to the nearest of `others` (m, 2), infinite without any (n,) [m]."""
    out = np.full(len(points), np.inf)
    for i in range(len(points)):
        for j in range(len(others)):
            dx, dy = points[i, 0] - others[j, 0], points[i, 1] - others[j, 1]
            out[i] = min(out[i], dx * dx + dy * dy)
    return np.sqrt(out)
