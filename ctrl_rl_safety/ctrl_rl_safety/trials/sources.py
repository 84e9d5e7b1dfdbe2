"""Adversaries: drivers that ignore obstacles, and decide in each tick of a trial."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import Sensors
from ctrl_rl_safety.models.quadrotor_model import QuadrotorModel
from ctrl_rl_safety.models.robot_model import RobotModel

Array = NDArray[np.float64]

_TICKS_PER_SECOND = 20.0
_HELD_S, _THRUST_HELD_S = (0.3, 2.0), (0.05, 0.5)


class Constant:
    """One constant command: full speed, or full thrust."""

    def __init__(self, command: ArrayLike) -> None:
        self._command = np.array(command, np.float64)

    def command(self, _: Sensors) -> Array:  # noqa: D102 - see Driver
        return self._command


class Random:
    """Random commands with random durations; half of them at full speed."""

    def __init__(self, model: RobotModel, seed: int) -> None:
        self._limits = np.array(model.limits)
        self._random = np.random.default_rng((seed, 8))
        self._held, self._left = np.zeros(2), 0

    def command(self, _: Sensors | None = None) -> Array:  # noqa: D102 - see Driver
        if not self._left:
            self._held = self._random.uniform(*self._limits)
            if self._random.random() < 0.5:
                self._held[0] = self._limits[self._random.integers(2), 0]
            self._left = round(_TICKS_PER_SECOND * self._random.uniform(*_HELD_S))
        self._left -= 1
        return self._held


class RandomThrusts:
    """Random thrusts with random durations; half of them equal, so that the quadrotor flies as well as tumbles."""

    def __init__(self, model: QuadrotorModel, seed: int, tick: float) -> None:
        self._least, self._most, self._tick = model.least, model.most, tick
        self._random = np.random.default_rng((seed, 9))
        self._held, self._left = np.zeros(2), 0

    def command(self, _: Sensors) -> Array:  # noqa: D102 - see Driver
        if not self._left:
            self._held = self._random.uniform(self._least, self._most, 2)
            if self._random.random() < 0.5:
                self._held[1] = self._held[0]
            seconds = round(_TICKS_PER_SECOND * self._random.uniform(*_THRUST_HELD_S)) / _TICKS_PER_SECOND
            self._left = max(1, round(seconds / self._tick))
        self._left -= 1
        return self._held
