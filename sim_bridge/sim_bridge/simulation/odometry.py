"""Pose measurement: drifting wheel odometry, and a localiser with errors."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometryReading:
    """Measured pose and velocity.

    Attributes:
        pose: Pose x, y, theta or x, z, psi (3,) [m, m, rad], in a frame that was `map` at the start.
        velocity: Velocity along the body's first and second axis, and its turn rate (3,) [m/s, m/s, rad/s].
    """

    pose: Array
    velocity: Array


class Odometry:
    """Integrates the robot's motion from its start pose; without drift, returns the true pose in the frame `map`.

    Each episode draws three errors with standard deviation `drift`: relative errors of distance and rotation, and a
    rotation per metre [rad/m] (wheels of unequal size).
    """

    def __init__(self, drift: float, random: np.random.Generator, pose: Array, wheel_radius: float = 1.0) -> None:
        """Start at the true pose.

        Args:
            drift: Standard deviation of the errors.
            random: Random generator of the errors.
            pose: Pose at the start (3,).
            wheel_radius: Ratio of the true to the assumed wheel radius.
        """
        self._distance, self._turn, self._bend = drift * random.standard_normal(3)
        if wheel_radius != 1.0:
            self._distance, self._turn = (
                (self._distance + 1.0) / wheel_radius - 1.0,
                (self._turn + 1.0) / wheel_radius - 1.0,
            )
        self._true = pose.copy()
        self._drifting = drift > 0.0 or wheel_radius != 1.0
        self.pose = pose.copy()

    def update(self, true_pose: Array) -> Array:
        """Return the measured pose (3,): two coordinates of the plane [m] and the counter-clockwise angle [rad].

        Args:
            true_pose: True pose (3,), less than half a turn from the previous one.
        """
        if not self._drifting:
            self.pose = true_pose.copy()
            return self.pose
        step = true_pose - self._true
        step[2] = wrap(step[2])
        middle = self._true[2] + 0.5 * step[2]
        c, s = np.cos(middle), np.sin(middle)
        forward, sideways = (1.0 + self._distance) * np.array((c * step[0] + s * step[1], c * step[1] - s * step[0]))
        turn = (1.0 + self._turn) * step[2] + self._bend * abs(forward)
        middle = self.pose[2] + 0.5 * turn
        c, s = np.cos(middle), np.sin(middle)
        self.pose = np.add(self.pose, (c * forward - s * sideways, s * forward + c * sideways, turn))
        self._true = true_pose.copy()
        return self.pose

    def speeds(self, forward: float, turn: float) -> tuple[float, float]:
        """Return the measured forward speed [m/s] and turn rate [rad/s]."""
        forward *= 1.0 + self._distance
        return forward, (1.0 + self._turn) * turn + self._bend * abs(forward)


_MEMORY = 5.0
"""Correlation time of the errors [s]."""


class Localiser:
    """Returns the true pose with slowly varying errors (Ornstein-Uhlenbeck processes)."""

    def __init__(self, error: float, heading_error: float, rate: float, random: np.random.Generator) -> None:
        """Draw the first errors.

        Args:
            error: Standard deviation of each coordinate [m].
            heading_error: Standard deviation of the angle [rad].
            rate: Poses per second [Hz].
            random: Random generator of the errors.
        """
        self._size = np.array((error, error, heading_error))
        self._kept = math.exp(-1.0 / (rate * _MEMORY))
        self._random = random
        self._error = self._size * random.standard_normal(3)

    @property
    def covariance(self) -> Array:
        """Variances of the pose (3,) [m^2, m^2, rad^2]."""
        return self._size**2

    def update(self, true_pose: Array) -> Array:
        """Return the next measured pose."""
        told = np.add(true_pose, self._error)
        fresh = self._size * self._random.standard_normal(3)
        self._error = self._kept * self._error + math.sqrt(1.0 - self._kept**2) * fresh
        return told


def correction(pose: Array, odometry: Array) -> Array:
    """Return the pose of the odometry frame in the map, given the robot's pose in both."""
    turn = float(pose[2] - odometry[2])
    offset = complex(*pose[:2]) - cmath.rect(1.0, turn) * complex(*odometry[:2])
    return np.array((offset.real, offset.imag, turn))
