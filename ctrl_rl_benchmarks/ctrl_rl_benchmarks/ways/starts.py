"""Training starts that grow with V: near the goal by the time to reach at first, and at the task's own in the end."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_training.sb3.environment import Environment, Vector
from numpy.typing import NDArray

from ctrl_rl_benchmarks.ways.potential import TimeToReach
from ctrl_rl_core import NavigationTask

_CANDIDATES = 20_000
_OWN = 0.3
"""Share of the episodes that start where the task says, whatever the level."""


def levels(
    task: NavigationTask, potential: TimeToReach, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return states (N, n) from which the goal can be reached, and their times (N,) [s], nearest first."""
    system = task.system.build()
    random = np.random.default_rng(seed)
    places = task.plane_bounds
    states = np.zeros((_CANDIDATES, len(system.state_names)))
    for index, name in enumerate(system.state_names):
        if name in places:
            states[:, index] = random.uniform(*places[name], _CANDIDATES)
        elif name == "theta":
            states[:, index] = random.uniform(-np.pi, np.pi, _CANDIDATES)
    times = potential.times(states)
    order = np.argsort(times)
    order = order[np.isfinite(times[order])]
    return states[order], times[order]


class GrowingStarts(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Draws starts from a level set of the time to reach that grows with the episodes of this environment that arrive.

    Args:
        environment: Environment of a task.
        states: States (N, n), nearest first.
        times: Their times to reach (N,) [s].
    """

    def __init__(self, environment: Environment, states: NDArray[np.float64], times: NDArray[np.float64]) -> None:
        super().__init__(environment)
        self._states, self._times = states, times
        self._longest = float(times[-1])
        self._level = 0.1 * self._longest

    def reset(self, **options: Any) -> tuple[Vector, dict[str, Any]]:
        """Start an episode."""
        random = self.env.unwrapped.np_random
        if random.random() >= _OWN:
            inside = int(np.searchsorted(self._times, self._level, "right"))
            start = self._states[random.integers(max(1, inside))]
            return self.env.reset(**{**options, "options": {"start": start}})
        return self.env.reset(**options)

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action; an arrival raises the level by a fortieth of the longest time, any other end lowers it."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            share = 0.025 if info["outcome"] == "GOAL" else -0.0125
            self._level = float(np.clip(self._level + share * self._longest, 0.1 * self._longest, self._longest))
        return observation, float(reward), terminated, truncated, info
