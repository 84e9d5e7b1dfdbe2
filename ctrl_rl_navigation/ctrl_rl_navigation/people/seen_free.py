"""The space that the beams of one scan passed through."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

Array = NDArray[np.float64]

_BINS = 360
_SCALE = 0.05
"""Relative error of the angle by which odometry says that the robot has turned."""
_TURN = 2.0 * math.pi
_BEFORE, _PER_METRE = 0.08, 0.015
"""Distance before its end up to which a beam shows free space: fixed [m], and share of the distance."""


class SeenFree:
    """Free range of a scan by direction.

    Attributes:
        time: Time of the scan [s].
    """

    def __init__(self, time: float, origin: Array, ends: Array, turned: float = 0.0) -> None:
        """Note a scan.

        Args:
            time: Time of the scan [s].
            origin: Position of the lidar (2,) [m].
            ends: End points of the beams (n, 2) [m].
            turned: Angle by which the robot has turned so far, to either side [rad].
        """
        self.time, self._origin, self._turned = time, origin, turned
        x, y = (ends - origin).T
        free = np.full(_BINS, np.inf)
        np.minimum.at(free, _places(x, y), np.hypot(x, y))
        # Neighbouring beams count as well: odometry errors displace an edge, and beams may lie farther apart than bins.
        free = np.minimum(free, np.minimum(np.roll(free, 1), np.roll(free, -1)))
        free[np.isinf(free)] = 0.0  # nothing is known where no beam goes
        self._free = free

    def shows_free(self, points: Array, radius: float = 0.0, turned: float | None = None) -> NDArray[np.bool_]:
        """Return whether beams passed through points (n, 2) [m], and a radius beyond them [m] (n,).

        Args:
            points: Points (n, 2) [m].
            radius: Radius around them that must be free as well [m].
            turned: Angle by which the robot has turned until it saw the points, or was to see them [rad]. A robot that
                turns sees a standing post wander, by the error of its odometry times the distance.
        """
        x, y = (points - self._origin).T
        away = np.hypot(x, y)
        error = 0.0 if turned is None else _SCALE * abs(turned - self._turned)
        free = self._free
        if error > 0.0:
            free = minimum_filter1d(free, 1 + 2 * math.ceil(error * _BINS / _TURN), mode="wrap")
        return np.asarray(free[_places(x, y)] > away * (1.0 + _PER_METRE) + _BEFORE + radius)


def _places(x: Array, y: Array) -> NDArray[np.intp]:
    return np.floor(np.mod(np.arctan2(y, x), _TURN) * (_BINS / _TURN)).astype(np.intp) % _BINS
