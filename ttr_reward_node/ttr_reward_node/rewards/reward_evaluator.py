"""The reward of a robot's state (thesis Eq. 3.9), from that state alone: for the node, and for recorded bags."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.values.value_function import check_function
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, TaskSets, ValueFunction, terminal_reward
from ttr_reward_node.rewards.rewards import KIND, check_informative, longest_time, time_to_reach_reward


class EvaluatedReward(NamedTuple):
    """Set that a state lies in, and its reward; NaN for an intermediate state outside the value function."""

    outcome: Outcome
    reward: float


class RewardEvaluator:
    """Evaluates the rewards of one task's states.

    Args:
        task: Task with the rewards and the sets G and C.
        function: Time to reach of the task.
        width: Width of the task's corridor [m], None for its own.

    Attributes:
        up_to_date: whether the function was made for this very version of the task.

    Raises:
        TaskError: the width does not suit the task.
        ValueFunctionError: the function does not belong to the task.
        TimeToReachError: the function knows of no way to the goal.
    """

    def __init__(self, task: NavigationTask, function: ValueFunction, width: float | None = None) -> None:
        self.up_to_date = check_function(function, task, KIND)
        check_informative(function)
        self._sets = TaskSets(task, width)
        self._rewards = task.rewards
        self._longest = longest_time(function)

    def __call__(self, state: NDArray[np.float64], phi: float) -> EvaluatedReward:
        """Return outcome and reward of a state (n,) whose time to reach is phi [s], +inf or NaN."""
        outcome = Outcome(int(self._sets.outcomes(state)))
        if outcome is not Outcome.RUNNING:
            return EvaluatedReward(outcome, float(terminal_reward(outcome, self._rewards)))
        # A learner may need a number where nothing is known; whoever reads a topic shall see that nothing is.
        return EvaluatedReward(
            outcome, math.nan if math.isnan(phi) else float(time_to_reach_reward(phi, self._longest))
        )
