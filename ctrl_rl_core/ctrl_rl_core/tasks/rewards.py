"""Terminal rewards of a task, by outcome."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.tasks.outcome import Outcome
from ctrl_rl_core.tasks.schema.parts import RewardSpec


def terminal_reward(
    outcomes: ArrayLike, rewards: RewardSpec, tilted: ArrayLike = False, running: float = 0.0
) -> NDArray[np.float64]:
    """Return the rewards (...) of outcomes (...) (thesis Eq. 3.9, 3.15, 3.17).

    Args:
        outcomes: Values of `Outcome` (...).
        rewards: Reward specification of the task.
        tilted: Whether each collision was a tilt beyond the task's limit (...).
        running: Reward while an episode continues.
    """
    table = np.zeros((2, len(Outcome)))
    table[:, Outcome.RUNNING] = running
    table[:, Outcome.GOAL] = rewards.goal
    table[:, Outcome.COLLISION] = rewards.collision, tilt_reward(rewards)
    table[:, Outcome.TRAP] = rewards.trap or 0.0
    table[:, Outcome.TIMEOUT] = rewards.timeout
    return table[np.asarray(tilted, dtype=np.intp), np.asarray(outcomes, dtype=np.intp)]


def tilt_reward(rewards: RewardSpec) -> float:
    """Return the reward for excessive tilt: that of a collision unless the task specifies another."""
    return rewards.collision if rewards.tilt is None else rewards.tilt
