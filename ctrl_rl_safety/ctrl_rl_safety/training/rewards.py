"""Shaping rewards in addition to the task's own: progress towards the goal, or towards a contact."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_learning.sb3 import Environment, Vector

from ctrl_rl_core import NavigationTask, Outcome

_PER_METRE = 100.0
_CONTACT = 1000.0


class Approach(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Adds 100 per metre of progress towards the goal's centre; reaching the goal gives 1000 in most tasks."""

    def __init__(self, environment: Environment, task: NavigationTask) -> None:
        super().__init__(environment)
        region = task.goal.region
        self._goal = np.array(region.disc.centre if region.disc else [region.intervals[n].centre for n in ("x", "y")])
        self._before = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._before = float(np.linalg.norm(info["state"][:2] - self._goal))
        return observation, info

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Advance by one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        before, self._before = self._before, float(np.linalg.norm(info["state"][:2] - self._goal))
        return observation, float(reward) + _PER_METRE * (before - self._before), terminated, truncated, info


class Attack(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Rewards contacts that the robot could have avoided, and each centimetre of approach to one.

    Such a contact counts as the goal, so an attacker's success rate is the fraction of its episodes with a contact.
    """

    def __init__(self, environment: Environment) -> None:
        super().__init__(environment)
        self._before = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._before = float(info["clearance"])
        return observation, info

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Advance by one step."""
        observation, _, terminated, truncated, info = self.env.step(action)
        before, self._before = self._before, max(float(info["clearance"]), 0.0)
        reward = _PER_METRE * (before - self._before)
        if info["avoidable"]:
            reward += _CONTACT
            info["outcome"] = Outcome.GOAL.name
        return observation, reward, terminated, truncated, info
