"""Rewards of the ways, for the robots of a fleet."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from ttr_reward_node.rewards.progress import BestProgress, Pay, Progress, Shaping
from ttr_reward_node.rewards.rewards import Reward

from ctrl_rl_benchmarks.ways.potential import Potential
from ctrl_rl_core import Outcome

Array = NDArray[np.float64]


class PotentialReward:
    """Pay for progress beside the task's own rewards, for the robots of a fleet.

    Args:
        potential: Seconds to the goal.
        make: Makes the pay of one robot.
        robots: Number of robots.
    """

    def __init__(self, potential: Potential, make: Callable[[], Pay], robots: int) -> None:
        self._potential, self._pays = potential, [make() for _ in range(robots)]

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Begin episodes of robots at their states (len(robots), n)."""
        for robot, seconds in zip(robots, self._potential.times(states).tolist(), strict=True):
            self._pays[robot].begin(seconds)

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return what a step pays each robot (N,)."""
        seconds = np.where(outcomes == Outcome.GOAL, 0.0, self._potential.times(states))
        ended = (outcomes != Outcome.RUNNING) & (outcomes != Outcome.TIMEOUT)
        paid = [pay.step(*each) for pay, *each in zip(self._pays, seconds.tolist(), ended.tolist(), strict=True)]
        return rewards + np.array(paid)


class StateReward:
    """A reward of thesis Table 3.3 while an episode goes on; how it ends pays what the task says."""

    def __init__(self, reward: Reward) -> None:
        self._reward = reward

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Do nothing: a state pays whatever came before."""

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return what a step pays each robot (N,)."""
        return np.where(outcomes == Outcome.RUNNING, self._reward.intermediate(states), rewards)


MakePay = Callable[[float, float], Pay]
PAYS: dict[str, MakePay] = {
    "progress": lambda longest, _: Progress(longest),
    "best_progress": lambda longest, _: BestProgress(longest),
    "shaping": Shaping,
}
"""Kinds of pay by name, each made from the longest time [s] and the discount of a step."""
