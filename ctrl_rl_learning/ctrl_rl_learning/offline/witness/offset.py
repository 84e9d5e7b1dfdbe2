"""One rigid shift and turn of all recorded poses: a wrong start of the localisation, not a moved wall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray

from ctrl_rl_learning.offline.witness.beams import FileWalls
from ctrl_rl_learning.offline.witness.record import Sightings

Array = NDArray[np.float64]
_BEAMS = 20_000
"""Number of beams that an offset is fitted to."""
_PIECE, _BEAMS_OF_PIECE = 10, 600
"""Number of scans over which a drift is as good as constant, and number of their beams that count."""
_LEAP, _LEAP_TURN = 0.4, math.radians(15.0)
"""Most that the offset of a piece differs from that of the piece before [m, rad]."""
_ROUNDS = 12
_FAR, _NEAR = 1.0, 0.05
"""Error of a range beyond which a beam does not count [m], and the scale beyond which it counts little."""
_SMALL_TURN = math.radians(0.5)
"""Turn that is not worth a word [rad]."""
_STIFFNESS = 1e-3
"""Weight of no offset for a beam: along a straight corridor nothing tells where a robot is."""


@dataclass(frozen=True)
class Offset:
    """A shift and a turn of poses about a place.

    Attributes:
        shift: Shift (2,) [m].
        turn: Turn, counter-clockwise [rad].
        about: Place that the turn is about (2,) [m].
    """

    shift: tuple[float, float]
    turn: float
    about: tuple[float, float]

    @property
    def size(self) -> float:
        """Length of the shift [m]."""
        return math.hypot(*self.shift)

    def __str__(self) -> str:
        """Say it in words."""
        turn = f" and {math.degrees(self.turn):+.1f} deg about ({self.about[0]:.1f}, {self.about[1]:.1f}) m"
        return f"({self.shift[0]:+.2f}, {self.shift[1]:+.2f}) m" + (turn if abs(self.turn) > _SMALL_TURN else "")

    def inverse(self) -> Offset:
        """Return the shift and turn that undo this one, about the place to which it takes its own."""
        x, y = self.shift
        return Offset((-x, -y), -self.turn, (self.about[0] + x, self.about[1] + y))

    def places(self, points: Array) -> Array:
        """Return points (n, 2) moved [m]."""
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        x, y = (points - self.about).T
        return np.stack((cos * x - sin * y, sin * x + cos * y), axis=1) + self.about + self.shift

    def moved(self, seen: Sightings) -> Sightings:
        """Return scans with their poses moved."""
        poses = np.column_stack((self.places(seen.poses[:, :2]), wrap(seen.poses[:, 2] + self.turn)))
        return replace(seen, poses=poses)


def fit_offset(seen: Sequence[Sightings], walls: FileWalls, begin: Offset | None = None, most: int = _BEAMS) -> Offset:
    """Return the shift and turn of all poses by which the scans fit a file's walls best, in robust least squares.

    Args:
        seen: Scans.
        walls: Walls of the file.
        begin: Shift and turn to begin with; none unless given.
        most: Number of beams that it is fitted to, about.
    """
    few = [_thinned(each, most // len(seen)) for each in seen]
    about = np.concatenate([each.poses[:, :2] for each in few]).mean(axis=0)
    offset = Offset((0.0, 0.0), 0.0, (float(about[0]), float(about[1])))
    if begin is not None:
        moved = begin.places(about[None])[0] - about
        offset = Offset((float(moved[0]), float(moved[1])), begin.turn, offset.about)
    scale = 4.0 * _NEAR
    for _ in range(_ROUNDS):
        slopes, errors = [], []
        for each in few:
            moved = offset.moved(each)
            file = walls.expect(moved)
            known = np.isfinite(each.ranges) & np.isfinite(file.middle) & np.isfinite(file.high)
            error = np.where(known, each.ranges, 0.0) - np.where(known, file.middle, 0.0)
            x, y = (moved.poses[:, :2] - offset.about - offset.shift).T[..., None]
            turned = file.slopes[..., 2] + x * file.slopes[..., 1] - y * file.slopes[..., 0]
            used = known & (np.abs(error) < _FAR)
            used[used] = file.high[used] - file.low[used] < _FAR
            slopes.append(np.stack((file.slopes[..., 0], file.slopes[..., 1], turned), axis=-1)[used])
            errors.append(error[used])
        a, b = np.concatenate(slopes), np.concatenate(errors)
        if len(b) < 3:
            break
        steep = np.maximum(np.linalg.norm(a[:, :2], axis=1), 1.0)  # a slanted beam says no more than a straight one
        a, b = a / steep[:, None], b / steep
        weights = 1.0 / (1.0 + (b / scale) ** 2) ** 2
        weighted = a * weights[:, None]
        step = np.linalg.solve(weighted.T @ a + _STIFFNESS * len(b) * np.eye(3), weighted.T @ b)
        dx, dy, turn = step.tolist()
        offset = Offset((offset.shift[0] + dx, offset.shift[1] + dy), offset.turn + turn, offset.about)
        scale = max(_NEAR, 0.7 * scale)
    return offset


def without_drift(seen: Sightings, walls: FileWalls) -> tuple[Sightings, float]:
    """Return scans at poses freed of a drift, and how far it moved nine tenths of them at most [m].

    Odometry drifts: each few scans of an episode have an offset of their own, which is near to the one before.
    """
    poses, sizes = seen.poses.copy(), np.zeros(len(seen.poses))
    for number in np.unique(seen.episodes):
        rows, offset = np.flatnonzero(seen.episodes == number), None
        for first in range(0, len(rows), _PIECE):
            chosen = rows[first : first + _PIECE]
            found = fit_offset([seen.rows(chosen)], walls, offset, _BEAMS_OF_PIECE)
            if _follows(found, offset):  # else too little is seen here to tell
                offset = found
            if offset is None:
                continue
            poses[chosen] = offset.moved(seen.rows(chosen)).poses
            sizes[chosen] = offset.size
    return replace(seen, poses=poses), float(np.quantile(sizes, 0.9))


def _follows(offset: Offset, before: Offset | None) -> bool:
    """Return whether an offset is near to the one before, none at the beginning of an episode."""
    shift, turn = (np.zeros(2), 0.0) if before is None else (before.places(np.array([offset.about]))[0], before.turn)
    leap = np.array(offset.shift) - (shift if before is None else shift - offset.about)
    return bool(np.hypot(*leap) < _LEAP and abs(offset.turn - turn) < _LEAP_TURN)


def _thinned(seen: Sightings, most: int) -> Sightings:
    """Return scans and beams at equal distances, in all not many more than `most` beams."""
    beams = max(1, len(seen.bearings) // 60)
    every = max(1, math.ceil(len(seen.poses) * math.ceil(len(seen.bearings) / beams) / most))
    few = seen.rows(slice(None, None, every))
    return replace(few, bearings=few.bearings[::beams], ranges=few.ranges[:, ::beams])
