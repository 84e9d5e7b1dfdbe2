"""Command sources of trials: adversaries that know nothing of obstacles, and policies."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from ctrl_rl_core.policies.policy import Policy
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, NavigationTask
from ctrl_rl_safety.models.robot_model import RobotModel
from sim_bridge import SimulatedWorld

Array = NDArray[np.float64]

_HELD_S = (0.3, 2.0)


class Source(Protocol):
    """A source of raw commands."""

    def command(self, world: SimulatedWorld) -> tuple[Array, float]:
        """Return a raw command (2,) [m/s, rad/s], and the time for which it holds [s]."""


class FullSpeed:
    """Full speed ahead, whatever is there."""

    def __init__(self, model: RobotModel) -> None:
        self._command = np.array((model.speed, 0.0))

    def command(self, world: SimulatedWorld) -> tuple[Array, float]:  # noqa: ARG002, D102 - see Source
        return self._command, 0.2


class Random:
    """Random commands, each for a random time; half of them at full speed."""

    def __init__(self, model: RobotModel, seed: int) -> None:
        self._limits = np.array(model.limits)
        self._random = np.random.default_rng((seed, 8))

    def command(self, world: SimulatedWorld) -> tuple[Array, float]:  # noqa: ARG002, D102
        command: Array = self._random.uniform(*self._limits)
        if self._random.random() < 0.5:
            command[0] = self._limits[self._random.integers(2), 0]
        return command, round(20.0 * self._random.uniform(*_HELD_S)) / 20.0


class Driver:
    """A policy as its node drives it: it decides at each scan, or at its own period."""

    def __init__(self, policy: Policy, task: NavigationTask) -> None:
        self._policy, self._last = policy, policy.rest
        self._goal = _middle(task) if "goal" in policy.needs else None
        period = 1.0 / task.lidar.rate if policy.period is None else policy.period
        self._period = round(20.0 * period) / 20.0

    def command(self, world: SimulatedWorld) -> tuple[Array, float]:  # noqa: D102
        policy = self._policy
        try:
            self._last = np.clip(policy.command(world.sensors(0, self._goal, self._last)), *policy.limits)
        except CtrlRlError:  # it gives none, so that its node would send rest
            return policy.rest, self._period
        return self._last, self._period


def _middle(task: NavigationTask) -> Array:
    """Return the middle of a task's goal as x, y, theta (3,)."""
    region = task.goal.region
    place = region.disc.centre if region.disc is not None else [region.intervals[name].centre for name in ("x", "y")]
    heading = region.intervals["theta"].centre if "theta" in region.intervals else 0.0
    return np.array((*place, math.remainder(heading, 2.0 * math.pi)))
