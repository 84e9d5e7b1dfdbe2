"""Differential drives rolling in the plane: N at once for a fleet, one for the planar engine."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import ArrayLike, NDArray

from sim_bridge.engines.planar_geometry import wheel_speeds
from sim_bridge.engines.planar_parts import wheeled_model

Array = NDArray[np.float64]


@cached_njit
def _roll(poses: Any, wheels: Any, settled: Any, constants: Any) -> None:
    """Advance drives by one physics step.

    Args:
        poses: Poses x, y, theta (N, 3) [m, m, rad], changed in place.
        wheels: For the left and right wheel: angles [rad], commanded speeds, lagged target speeds of the motors, and
            actual speeds [rad/s] (4, N, 2); all but the commanded speeds are changed in place.
        settled: Whether both wheels have reached their target speeds (N,), changed in place.
        constants: Fraction by which the targets approach the commanded speed per step; speed change per impulse of a
            wheel and of the other wheel [rad/s per N m s]; maximum impulse per step [N m s]; duration of a step [s];
            distance [m] per sum, and half the rotation [rad] per difference, of the wheel speeds (7,).
    """
    share, own, shared, impulse, step, per_sum, per_difference = constants
    angles, wanted, held, speeds = wheels
    for i in range(len(poses)):
        if wanted[i, 0] != held[i, 0] or wanted[i, 1] != held[i, 1]:
            gap = 0.0
            for wheel in range(2):
                held[i, wheel] += share * (wanted[i, wheel] - held[i, wheel])
                gap += abs(held[i, wheel] - wanted[i, wheel])
            if gap < 1e-6:
                held[i] = wanted[i]
            settled[i] = False
        if not settled[i]:
            settled[i] = wheel_speeds(speeds[i], held[i], own, shared, impulse)
        angles[i, 0] += speeds[i, 0] * step
        angles[i, 1] += speeds[i, 1] * step
        way = per_sum * (speeds[i, 0] + speeds[i, 1])
        half_turn = per_difference * (speeds[i, 1] - speeds[i, 0])
        chord = way if abs(half_turn) < 1e-9 else way * math.sin(half_turn) / half_turn
        poses[i, 0] += chord * math.cos(poses[i, 2] + half_turn)
        poses[i, 1] += chord * math.sin(poses[i, 2] + half_turn)
        poses[i, 2] += 2.0 * half_turn


class RollingDrives:
    """Identical drives that roll without slipping, on velocity motors with a lag and limited torque.

    Args:
        urdf: Path of the robots' file, or its name in `urdf/`.
        torque: Maximum torque of one wheel [N m].
        size: Number of robots.
        rate: Physics steps per second [Hz].
        lag: Time constant of the motors' target speeds [s].

    Attributes:
        poses: Poses x, y, theta (N, 3) [m, m, rad].
        angles: Angles of the left and right wheel (N, 2) [rad].
        wanted: Commanded speeds of the wheels (N, 2) [rad/s].
    """

    def __init__(self, urdf: str, torque: float, size: int, rate: int, lag: float = 0.0) -> None:
        model = wheeled_model(urdf)
        self._radius, self._separation = model.wheel_radius, model.wheel_separation
        share = -math.expm1(-1.0 / (rate * lag)) if lag > 0.0 else 1.0
        per_sum = 0.5 * self._radius / rate
        motors = (*model.answers, torque / rate)
        self._constants = (share, *motors, 1.0 / rate, per_sum, per_sum / self._separation)
        self.poses, self._wheels = np.zeros((size, 3)), np.zeros((4, size, 2))
        self.angles, self.wanted, _, self._speeds = self._wheels
        self._settled = np.ones(size, dtype=np.bool_)

    def begin(self, index: int, pose: ArrayLike) -> None:
        """Place a robot at rest at a pose (3,)."""
        self.poses[index], self._wheels[:, index], self._settled[index] = pose, 0.0, True

    def advance(self) -> None:
        """Move by one physics step."""
        _roll(self.poses, self._wheels, self._settled, self._constants)

    def twist(self, index: int) -> tuple[float, float]:
        """Return one robot's speed [m/s] and turn rate [rad/s] as floats, faster than arrays for one robot."""
        left, right = self._speeds[index].tolist()
        return 0.5 * self._radius * (left + right), self._radius * (right - left) / self._separation

    def velocities(self) -> Array:
        """Return the rates of the poses (N, 3) [m/s, m/s, rad/s]."""
        left, right = self._speeds.T
        v, theta = 0.5 * self._radius * (left + right), self.poses[:, 2]
        omega = self._radius * (right - left) / self._separation
        return np.stack((v * np.cos(theta), v * np.sin(theta), omega), axis=1)
