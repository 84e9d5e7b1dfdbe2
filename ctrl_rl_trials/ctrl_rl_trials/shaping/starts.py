"""Training starts that grow with V: near the goal by the time to reach at first, and at the task's own in the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome
from ttr_reward_node import TimeToReach

Array = NDArray[np.float64]

_CANDIDATES = 20_000
_OWN = 0.3
"""Share of the episodes that start where the task says, whatever the level."""


def levels(task: NavigationTask, potential: TimeToReach, seed: int = 0) -> tuple[Array, Array]:
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


class GrowingStarts:
    """Starts in a level set of the time to reach that grows as a robot's episodes arrive.

    An arrival raises the robot's level by a fortieth of the longest time; any other end lowers it by half as much.

    Args:
        states: States (N, n), nearest first.
        times: Their times to reach (N,) [s].
        robots: Number of robots.
    """

    def __init__(self, states: Array, times: Array, robots: int) -> None:
        self._states, self._times = states, times
        self._longest = float(times[-1])
        self._levels = np.full(robots, 0.1 * self._longest)

    def draw(self, robot: int, random: np.random.Generator) -> Array | None:
        """Return the state (n,) in which an episode of a robot starts; None where the task is to draw it."""
        if random.random() < _OWN:
            return None
        inside = int(np.searchsorted(self._times, self._levels[robot], "right"))
        return np.asarray(self._states[random.integers(max(1, inside))])

    def ended(self, robot: int, outcome: Outcome) -> None:
        """Take how an episode of a robot ended."""
        share = 0.025 if outcome is Outcome.GOAL else -0.0125
        level = self._levels[robot] + share * self._longest
        self._levels[robot] = np.clip(level, 0.1 * self._longest, self._longest)
