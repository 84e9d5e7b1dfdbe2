"""Drivers of the loop: a scripted one that arrives now and then, and any policy, both with noise that explores."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray

from ctrl_rl_core import Driver, NavigationTask, Policy, Sensors

Array = NDArray[np.float64]
_LOOK = 1.3
"""Bearing up to which a driver without a goal looks for room [rad]."""


class RandomDriver(Driver[Sensors], Protocol):
    """A driver that draws anew in each episode."""

    def begin(self, random: np.random.Generator) -> None:
        """Begin an episode."""


class ScriptedDriver:
    """Drives to the goal, or to open space if there is none; turns away from obstacles, often too late.

    Each episode draws a speed, a distance at which it begins to turn away, and a drifting steering error.
    """

    def __init__(self, task: NavigationTask) -> None:
        commands = list(task.robot.commands.values())
        self._low, self._high = np.array(commands).T
        self._radius = task.robot.radius
        self._reach = task.lidar.range.high
        self._pace, self._error = ((0.23, 0.5), 0.35) if task.corridor is None else ((0.6, 1.0), 0.5)

    def begin(self, random: np.random.Generator) -> None:
        """Draw this episode's manner."""
        self._random = random
        self._speed = random.uniform(*self._pace) * self._high[0]
        self._care = random.uniform(1.5, 4.0) * self._radius + random.uniform(0.2, 0.7)
        self._drift, self._size = 0.0, random.uniform(0.0, self._error)

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,): speed [m/s] and turn rate [rad/s]."""
        scan = sensors.scan
        angles = wrap(scan.angle_min + scan.angle_increment * np.arange(scan.beams))
        ranges = np.nan_to_num(sensors.ranges.astype(np.float64), nan=self._reach, posinf=self._reach, neginf=0.0)
        turn = 1.5 * self._bearing(sensors, angles, ranges)
        ahead = (np.abs(angles) < 1.2) & (ranges < self._care)
        if ahead.any():
            nearest = int(np.argmin(np.where(ahead, ranges, np.inf)))
            turn = -math.copysign(2.0, angles[nearest])
        self._drift += -0.2 * self._drift + self._size * self._high[1] * self._random.normal()
        turn += self._drift
        speed = self._speed * (0.7 if ahead.any() else 1.0) * (1.0 + 0.2 * self._random.normal())
        return np.clip((speed, turn), self._low, self._high)

    def _bearing(self, sensors: Sensors, angles: Array, ranges: Array) -> float:
        """Return where to go, from ahead to the left [rad]."""
        if sensors.goal is None or sensors.pose is None:
            room = np.where(np.abs(angles) < _LOOK, ranges, 0.0) ** 2
            return float((room * angles).sum() / max(float(room.sum()), 1e-9))
        x, y, theta = sensors.pose
        return float(wrap(math.atan2(sensors.goal[1] - y, sensors.goal[0] - x) - theta))


class NoisyPolicy:
    """A policy as a node runs it, with noise that is held for a while, in part of the episodes.

    Args:
        policy: Policy of any kind.
        noise: Standard deviation of the noise, as a share of half the range of each command; 0 for none.
        share: Share of the episodes that have noise.
    """

    def __init__(self, policy: Policy, noise: float = 0.0, share: float = 0.5) -> None:
        self._policy, self._noise, self._share = policy, noise, share
        self._low, self._high = policy.limits
        self._offset = np.zeros(2)
        self._size = 0.0

    def begin(self, random: np.random.Generator) -> None:
        """Draw whether this episode has noise."""
        self._random = random
        self._size = self._noise if random.uniform() < self._share else 0.0
        self._offset = np.zeros(2)

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,)."""
        command = np.clip(self._policy.command(sensors), self._low, self._high)
        if self._size:
            self._offset = 0.6 * self._offset + 0.8 * self._random.normal(size=2)
            command = command + self._size * 0.5 * (self._high - self._low) * self._offset
        return np.clip(command, self._low, self._high)
