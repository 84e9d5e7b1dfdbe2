"""Rewards of the ways, for the robots of a fleet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from ttr_reward_node.rewards.rewards import Reward

from ctrl_rl_core import Outcome

Array = NDArray[np.float64]


class StateReward:
    """A reward of thesis Table 3.3 while an episode goes on; how it ends pays what the task says."""

    def __init__(self, reward: Reward) -> None:
        self._reward = reward

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Do nothing: a state pays whatever came before."""

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return what a step pays each robot (N,)."""
        return np.where(outcomes == Outcome.RUNNING, self._reward.intermediate(states), rewards)
