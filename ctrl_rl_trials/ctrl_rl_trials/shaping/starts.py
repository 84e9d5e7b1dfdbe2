"""Start curriculum by the time to reach: starts near the goal at first, and the task's own starts in the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome
from ttr_reward_node import TimeToReach

Array = NDArray[np.float64]

_CANDIDATES = 20_000
_OWN = 0.3
"""Share of the episodes that use the task's own starts at any level."""


def levels(task: NavigationTask, potential: TimeToReach, seed: int = 0) -> tuple[Array, Array]:
    """Return states (N, n) from which the goal is reachable, and their times to reach (N,) [s], in ascending order."""
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


class GrowingStarts:
    """Curriculum of starts in a sublevel set of the time to reach, which grows with the robot's success.

    Reaching the goal raises the robot's level by a fortieth of the longest time; any other outcome lowers it by half
    as much.

    Args:
        states: States (N, n) by ascending time to reach.
        times: Times to reach of the states (N,) [s].
        robots: Number of robots.
    """

    def __init__(self, states: Array, times: Array, robots: int) -> None:
        self._states, self._times = states, times
        self._longest = float(times[-1])
        self._levels = np.full(robots, 0.1 * self._longest)

    def draw(self, robot: int, random: np.random.Generator) -> Array | None:
        """Return the start state (n,) of a robot's next episode; None to let the task draw it."""
        if random.random() < _OWN:
            return None
        inside = int(np.searchsorted(self._times, self._levels[robot], "right"))
        return np.asarray(self._states[random.integers(max(1, inside))])

    def ended(self, robot: int, outcome: Outcome) -> None:
        """Adjust a robot's level to the outcome of its episode."""
        share = 0.025 if outcome is Outcome.GOAL else -0.0125
        level = self._levels[robot] + share * self._longest
        self._levels[robot] = np.clip(level, 0.1 * self._longest, self._longest)
