"""How an episode that runs out of time ends for the learner."""

from __future__ import annotations

from typing import Any

import gymnasium
from ctrl_rl_training.sb3.environment import Environment, Vector

from sim_bridge import NavigationEnv


class PaidTimeOut(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Where a task pays for a time-out it is an end like goal and collision, and the return ends with what is paid.

    Where it pays nothing, the limit only cuts the episode: the return goes on with the value of the last state.
    """

    def __init__(self, environment: Environment) -> None:
        super().__init__(environment)
        bare = environment.unwrapped
        assert isinstance(bare, NavigationEnv)
        self._paid = bare.task.rewards.timeout != 0.0

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action for the task's time step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._paid and truncated:
            terminated, truncated = True, False
        return observation, float(reward), terminated, truncated, info
