"""Detects a robot that should drive but makes no progress."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STAYS = 0.1
"""Radius within which a robot counts as staying in place [m]."""
_TURNS = 0.5
"""Rotation that counts as progress in place [rad]."""
_PATIENCE = 1.0
"""Time without progress after which a robot is stuck [s]."""
_LEFT = 0.5
"""Distance from the place at which the robot is no longer stuck [m]."""


class StuckWatch:
    """Tracks poses; a robot that stays in one place is stuck until it leaves."""

    def __init__(self) -> None:
        self._pose: Array = np.full(3, math.inf)
        self._since, self._stuck = math.inf, False

    def stuck(self, now: float, pose: Array) -> bool:
        """Return whether the robot is stuck.

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
