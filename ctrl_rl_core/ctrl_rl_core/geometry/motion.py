"""Motion of a point along a curve over time: polylines at constant speed, and key frames.

Positions are (x, y) in the task's plane [m], times are since the motion began [s].
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

Pair = tuple[float, float]


@dataclass(frozen=True)
class Motion:
    """A piecewise cubic curve over time.

    Attributes:
        times: Start times of the pieces and the end of the last one (n + 1,), increasing from 0 [s].
        pieces: Coefficients of x and y for each piece (n, 2, 4), lowest power first, over the elapsed fraction of the
            piece.
        repeats: Whether the motion restarts at its end; otherwise it stays there.
    """

    times: tuple[float, ...]
    pieces: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]
    repeats: bool

    @property
    def duration(self) -> float:
        """Duration of one pass [s]."""
        return self.times[-1]

    @property
    def closed(self) -> bool:
        """Whether a pass ends at its start point."""
        return math.dist(self.position(0.0), self._evaluate(len(self.pieces) - 1, 1.0)) < 1e-6

    @cached_property
    def top_speed(self) -> float:
        """Maximum speed [m/s]."""
        cubic, spans = np.array(self.pieces), np.diff(self.times)
        share = np.linspace(0.0, 1.0, 33)[:, None, None]
        slopes = cubic[..., 1] + share * (2.0 * cubic[..., 2] + share * 3.0 * cubic[..., 3])
        return float((np.linalg.norm(slopes, axis=2) / spans).max())

    def position(self, time: float) -> Pair:
        """Return the position at a time [m]."""
        return self._evaluate(*self._piece(time))

    def velocity(self, time: float) -> Pair:
        """Return the velocity at a time [m/s]; zero at the end of a motion that does not repeat."""
        if not self.repeats and time >= self.duration:
            return 0.0, 0.0
        index, share = self._piece(time)
        span = self.times[index + 1] - self.times[index]
        x, y = (c[1] + share * (2.0 * c[2] + share * 3.0 * c[3]) for c in self.pieces[index])
        return x / span, y / span

    def _piece(self, time: float) -> tuple[int, float]:
        """Return the piece at a time, and its elapsed fraction."""
        time = time % self.duration if self.repeats else min(time, self.duration)
        index = min(bisect_right(self.times, time), len(self.pieces)) - 1
        begin = self.times[index]
        return index, (time - begin) / (self.times[index + 1] - begin)

    def _evaluate(self, index: int, share: float) -> Pair:
        x, y = (c[0] + share * (c[1] + share * (c[2] + share * c[3])) for c in self.pieces[index])
        return x, y


def polyline(points: ArrayLike, speed: float, repeat: str) -> Motion:
    """Return a motion along straight lines at constant speed; duplicate consecutive points are merged.

    Args:
        points: Corners (n, 2) [m], at least two of them distinct.
        speed: Constant speed along the lines [m/s].
        repeat: "once", "loop" (back to the first point in a straight line) or "back_and_forth".

    Raises:
        ValueError: All points are equal.
    """
    corners = np.asarray(points, float)
    if repeat == "loop":
        corners = np.concatenate((corners, corners[:1]))
    elif repeat == "back_and_forth":
        corners = np.concatenate((corners, corners[-2::-1]))
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    kept = np.concatenate(([True], lengths > 1e-6))
    corners, lengths = corners[kept], lengths[kept[1:]]
    if not len(lengths):
        raise ValueError("a motion needs two different points")
    times = np.concatenate(([0.0], np.cumsum(lengths / speed)))
    pieces = [
        ((x, right - x, 0.0, 0.0), (y, up - y, 0.0, 0.0))
        for (x, y), (right, up) in zip(corners[:-1].tolist(), corners[1:].tolist(), strict=True)
    ]
    return Motion(tuple(times.tolist()), tuple(pieces), repeat != "once")


def catmull_rom(times: Sequence[float], points: ArrayLike, repeats: bool) -> Motion:
    """Return the Catmull-Rom spline through key frames, with linear time between frames.

    The slopes are those of Gazebo's animations (ignition-math, class Spline): half the difference between the
    neighbours; at an open end, half the difference to the only neighbour. A closed curve is smooth where its ends meet.

    Args:
        times: Times of the frames (n,), rising from 0 [s].
        points: Positions (n, 2) [m].
        repeats: Whether the motion restarts at its end.
    """
    places = np.asarray(points, float)
    before, after = np.roll(places, 1, axis=0), np.roll(places, -1, axis=0)
    if np.array_equal(places[0], places[-1]):
        before[0], after[-1] = places[-2], places[1]
    else:
        before[0], after[-1] = places[0], places[-1]
    slopes = 0.5 * (after - before)
    pieces = []
    for p, q, m, n in zip(places[:-1], places[1:], slopes[:-1], slopes[1:], strict=True):
        cubic = np.stack((p, m, 3.0 * (q - p) - 2.0 * m - n, 2.0 * (p - q) + m + n))
        pieces.append((tuple(cubic[:, 0].tolist()), tuple(cubic[:, 1].tolist())))
    return Motion(tuple(float(time) for time in times), tuple(pieces), repeats)
