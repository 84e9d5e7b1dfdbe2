"""The simulated tasks with another reward, as a Gymnasium wrapper: the algorithm is left alone (thesis Fig. 3.2).

environment = make_rewarded(make_reward("sparse", load_navigation_task("car_ttr")))
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_training.sb3.environment import Environment, Vector, make_environment

from ctrl_rl_core import Outcome
from ttr_reward_node.rewards.rewards import Reward


class RewardWrapper(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Pays one of the rewards of Table 3.3 instead of the task's own.

    Args:
        environment: Environment of a task of the suite.
        reward: Reward that is paid for the true state.
    """

    def __init__(self, environment: Environment, reward: Reward) -> None:
        super().__init__(environment)
        self._reward = reward

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action for the task's time step."""
        observation, paid, terminated, truncated, info = self.env.step(action)
        # How an episode ends pays what the task says, whichever the reward: the environment has paid it already.
        if not (terminated or truncated):
            paid = self._reward(info["state"][None], np.array([Outcome.RUNNING]))[0]
        return observation, float(paid), terminated, truncated, info


def make_rewarded(reward: Reward, rate: int | None = None) -> Environment:
    """Return the environment of the reward's task that pays it, at the physics rate `rate` [Hz] or the task's own."""
    return make_environment(reward.task, rate, lambda environment: RewardWrapper(environment, reward))
