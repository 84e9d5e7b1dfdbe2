"""A driver without a model, to record drives: it keeps between the walls and adds noise to its commands.

EDMD needs data in which the controls are excited and the robot is seen off its middle line; this driver is no
competitor of what is learned from it.
"""

from __future__ import annotations

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.sensing.observables import CorridorObservables

_SIDE_GAIN = 1.8
_AHEAD_GAIN = 0.6
_MEMORY = 0.8


class ScriptedDriver:
    """Steers to the side with more room, at a wandering speed, with coloured noise on both commands."""

    def __init__(self, random: np.random.Generator, speed: float, turn_noise: float, speed_noise: float) -> None:
        """Make a driver.

        Args:
            random: Source of the noise.
            speed: Mean speed [m/s].
            turn_noise: Standard deviation of the noise on the turn rate [rad/s].
            speed_noise: Standard deviation of the noise on the speed [m/s].
        """
        self.sectors = CorridorObservables().sectors
        self._random = random
        self._speed = speed
        self._deviation = np.array([speed_noise, turn_noise])
        self._noise = np.zeros(2)
        left = np.rad2deg(self.sectors.bearings[len(self.sectors.bearings) // 2 :])
        self._beside, self._ahead = (left >= 60) & (left <= 120), (left >= 20) & (left <= 60)

    def command(self, distances: Array) -> Array:
        """Return speed [m/s] and turn rate [rad/s] (2,) for the distances of `sectors` [m]."""
        half = len(distances) // 2
        left, right = distances[half:], distances[half - 1 :: -1]
        off_middle = np.mean(right[self._beside] - left[self._beside])
        bend = np.mean(np.log(right[self._ahead] / left[self._ahead]))
        step = np.sqrt(1.0 - _MEMORY**2) * self._deviation * self._random.standard_normal(2)
        self._noise = _MEMORY * self._noise + step
        return np.array([self._speed, -_SIDE_GAIN * off_middle - _AHEAD_GAIN * bend]) + self._noise
