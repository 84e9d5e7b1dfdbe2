"""The length and the rewards of an episode in a task file."""

from __future__ import annotations

from ctrl_rl_core.geometry.units import TimeStep
from ctrl_rl_core.tasks.schema.parts import Part, Reward, Steps


class EpisodeSpec(Part):
    """Length of an episode: steps of a policy at most, and the duration of a step."""

    steps: Steps
    time_step: TimeStep


class RewardSpec(Part):
    """Rewards of a task by the outcome of a step (thesis Eq. 3.9, 3.15, 3.17)."""

    goal: Reward
    collision: Reward
    intermediate: Reward = 0.0
    trap: Reward | None = None
    timeout: Reward = 0.0
    tilt: Reward | None = None
