"""Compare the motion of the odometry's pose with its speeds; a difference means slip or faulty odometry."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SPAN = 1.0
"""Time span of the comparison between pose and speeds [s]."""
_ERROR, _RELATIVE = 0.03, 0.05
"""Error of the distance between two poses: a part [m], and a fraction of the path."""
_OFFSET = 0.1
"""Time by which the speeds of an odometry may be older than its pose [s]."""
_LONGEST = 0.3
"""Longest interval between two measurements [s]."""


class Slip:
    """Motion of the pose that the speeds do not explain.

    Attributes:
        rate: Maximum unexplained motion per second [m/s].
    """

    def __init__(self) -> None:
        self.rate = 0.0
        self.forget()

    def forget(self) -> None:
        """Restart because the pose has jumped."""
        self._last: tuple[float, Array, float] | None = None
        self._apart, self._way = np.zeros(2), 0.0
        self._before: deque[tuple[float, Array, float, float]] = deque()

    def measure(self, time: float, pose: Array, v: float) -> None:
        """Compare a pose (3,) [m, m, rad] with the speed [m/s] since the last one, at a time [s]."""
        last = self._last
        self._last = time, pose.copy(), v
        if last is None or time - last[0] > _LONGEST:
            self.forget()
            self._last = time, pose.copy(), v
            return
        way = 0.5 * (last[2] + v) * (time - last[0])
        middle = last[1][2] + 0.5 * math.remainder(float(pose[2] - last[1][2]), 2.0 * math.pi)
        self._apart = self._apart + pose[:2] - last[1][:2] - way * np.array((math.cos(middle), math.sin(middle)))
        self._way += abs(way)
        self._before.append((time, self._apart, self._way, v))
        while len(self._before) > 1 and self._before[1][0] <= time - _SPAN:
            self._before.popleft()
        first = self._before[0]
        if time - first[0] < _SPAN - _LONGEST:
            return
        speeds = [each[3] for each in self._before]
        error = _ERROR + _RELATIVE * (self._way - first[2]) + _OFFSET * (max(speeds) - min(speeds))
        apart = math.dist(self._apart.tolist(), first[1].tolist())
        self.rate = max(self.rate, (apart - error) / (time - first[0]))
