"""Identifies the echoes of moving objects in a scan, and their velocities.

Neighbouring echoes form a group. A small, complete group is tracked from scan to scan by its centre; if a straight line
fits its recent positions and is fast enough, its echoes get that velocity. All other echoes count as static.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_GAP = 0.3
"""Distance between neighbouring echoes above which they belong to different groups [m]."""
_SIZES = (0.08, 1.2)
"""Minimum and maximum extent of a tracked group [m]."""
_LEAST_ECHOES = 4
_BESIDE = 0.03
"""Maximum angle between echoes of neighbouring beams [rad]."""
_FAR = 7.0
"""Maximum distance of tracked groups [m]."""
_JUMP = 0.3
"""Maximum deviation from the expected position of a tracked group [m]."""
_MEMORY = 0.5
"""Time window of the positions used for the line fit [s]."""
_LEAST_TIME = 0.2
"""Minimum tracking time of a group [s]."""
_SLOWEST = 0.3
"""Speed below which a group counts as static [m/s], since its visible side changes as the robot moves."""
_MISFIT = 0.04
"""Maximum root mean square distance of the positions from the line [m]."""


@dataclass
class _Track:
    places: deque[tuple[float, float, float]] = field(default_factory=deque)  # time, x, y
    velocity: Array = field(default_factory=lambda: np.zeros(2))

    def expected(self, now: float) -> Array:
        """Return the predicted position at a time (2,) [m]."""
        time, x, y = self.places[-1]
        return np.array((x, y)) + self.velocity * (now - time)

    def take(self, now: float, place: Array) -> None:
        """Add a position, and update the line fit."""
        self.places.append((now, float(place[0]), float(place[1])))
        while now - self.places[0][0] > _MEMORY:
            self.places.popleft()
        if now - self.places[0][0] < _LEAST_TIME:
            self.velocity = np.zeros(2)
            return
        known = np.array(self.places)
        time = known[:, 0] - known[:, 0].mean()
        offset = known[:, 1:] - known[:, 1:].mean(axis=0)
        velocity = time @ offset / (time @ time)
        misfit = float(np.sqrt(((offset - time[:, None] * velocity) ** 2).sum(axis=1).mean()))
        moves = float(np.hypot(*velocity)) >= _SLOWEST and misfit <= _MISFIT
        self.velocity = velocity if moves else np.zeros(2)


class MovingEchoes:
    """Tracks groups of echoes from scan to scan."""

    def __init__(self) -> None:
        self._tracks: list[_Track] = []

    def update(self, now: float, origin: Array, echoes: Array) -> Array:
        """Process a scan and return the velocity of each echo (n, 2) [m/s].

        Args:
            now: Steady time [s].
            origin: Position of the lidar (2,) [m].
            echoes: Echoes in beam order (n, 2) [m], in a fixed frame.
        """
        velocities = np.zeros_like(echoes)
        tracks = []
        for part in _groups(origin, echoes):
            place = 0.5 * (echoes[part].min(axis=0) + echoes[part].max(axis=0))
            track = self._nearest(now, place)
            track.take(now, place)
            tracks.append(track)
            velocities[part] = track.velocity
        self._tracks = tracks + [each for each in self._tracks if now - each.places[-1][0] < _MEMORY]
        return velocities

    def _nearest(self, now: float, place: Array) -> _Track:
        """Return the track that a group continues, removed from the list, or a new track."""
        gaps = [float(np.hypot(*(each.expected(now) - place))) for each in self._tracks]
        if gaps and min(gaps) < _JUMP:
            return self._tracks.pop(int(np.argmin(gaps)))
        return _Track()


def _groups(origin: Array, echoes: Array) -> list[slice]:
    """Return the groups that are small, complete and near."""
    if len(echoes) < _LEAST_ECHOES:
        return []
    x, y = (echoes - origin).T
    ranges, turns = np.hypot(x, y), np.diff(np.arctan2(y, x))
    beside = np.abs(np.remainder(turns + np.pi, 2.0 * np.pi) - np.pi) < _BESIDE
    breaks = np.flatnonzero(np.hypot(*np.diff(echoes, axis=0).T) > _GAP) + 1
    edges = [0, *breaks.tolist(), len(echoes)]
    out = []
    for begin, end in pairwise(edges):
        part = slice(begin, end)
        extent = float(np.hypot(*(echoes[part].max(axis=0) - echoes[part].min(axis=0))))
        # An object in front of a group's edge hides the rest of the group.
        hidden = begin > 0 and beside[begin - 1] and ranges[begin - 1] < ranges[begin]
        hidden |= end < len(echoes) and beside[end - 1] and ranges[end] < ranges[end - 1]
        small = end - begin >= _LEAST_ECHOES and _SIZES[0] <= extent <= _SIZES[1]
        if small and not hidden and ranges[part].min() <= _FAR:
            out.append(part)
    return out
