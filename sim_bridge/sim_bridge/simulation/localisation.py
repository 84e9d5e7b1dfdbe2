"""A localiser in a map, like AMCL, with errors of a given size.

Poses are (3,): two coordinates of the plane [m] and the angle, counter-clockwise [rad].
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
        """Return the next pose."""
        told = np.add(true_pose, self._error)
        fresh = self._size * self._random.standard_normal(3)
        self._error = self._kept * self._error + math.sqrt(1.0 - self._kept**2) * fresh
        return told


def correction(pose: Array, odometry: Array) -> Array:
    """Return the pose of odometry's frame in the map, given the robot's pose in both."""
    turn = float(pose[2] - odometry[2])
    offset = complex(*pose[:2]) - cmath.rect(1.0, turn) * complex(*odometry[:2])
    return np.array((offset.real, offset.imag, turn))
