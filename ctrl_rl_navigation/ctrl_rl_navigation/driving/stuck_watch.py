"""Tells whether a robot that is to drive gets on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STAYS = 0.1
"""Distance within which a robot stays about a place [m]."""
_TURNS = 0.5
"""Turn by which it gets on where it stays [rad]."""
_PATIENCE = 1.0
"""Time after which a robot that does not get on is stuck [s]."""
_LEFT = 0.5
"""Distance from the place at which it no longer is [m]."""


class StuckWatch:
    """Takes poses; a robot that stays in one is stuck until it has left the place."""

    def __init__(self) -> None:
        self._pose: Array = np.full(3, math.inf)
        self._since, self._stuck = math.inf, False

    def stuck(self, now: float, pose: Array) -> bool:
        """Return whether a robot is stuck.

        Args:
            now: Steady time [s].
            pose: Pose x, y, theta of the robot (3,) [m, m, rad].
        """
        moved = math.dist(pose[:2], self._pose[:2])
        if self._stuck:
            self._stuck = moved < _LEFT
        elif moved > _STAYS or abs(math.remainder(pose[2] - self._pose[2], 2.0 * math.pi)) > _TURNS:
            self._pose, self._since = pose.copy(), now
        else:
            self._stuck = now - self._since >= _PATIENCE
        return self._stuck
