"""Evaluates policies: episodes and their averages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.roll_out import JointDecisionPolicy, OptionEpisode, play_episodes
from option_coordinator.policies.joint_policy import JointPolicy

DRAWS, MODE = "draws", "mode"
"""Ways to use a policy: its draws (for Q-learning, its final exploration), or its most likely options."""
_SEED = 2_000_000


def fresh(episodes: int) -> range:
    """Return the seeds of evaluation episodes: the same worlds for every policy, none of them used in learning."""
    return range(_SEED, _SEED + episodes)


def evaluate(
    environment: OptionEnvironment, draws: JointPolicy, mode: JointPolicy, episodes: int, seed: int
) -> dict[str, dict[str, float]]:
    """Evaluate both uses of a policy, `DRAWS` and `MODE`, in the same episodes; see `summary`.

    Args:
        environment: Environment to play in.
        draws: Policy whose options are drawn.
        mode: Policy whose most likely options are taken; with few observations it may run in circles.
        episodes: Number of episodes of each use.
        seed: Seed of the run; worlds are the same for all runs, draws are each run's own.
    """
    seeds = fresh(episodes)
    choosers = {
        DRAWS: JointDecisionPolicy(draws, np.random.default_rng((_SEED, seed, 1))),
        MODE: JointDecisionPolicy(mode),
    }
    return {how: summary(list(play_episodes(environment, chooser, seeds))) for how, chooser in choosers.items()}


def summary(episodes: Sequence[OptionEpisode]) -> dict[str, float]:
    """Return what episodes amount to; nothing for no episodes.

    Means over episodes are `return`, `steps`, `decisions`, `terminated` and what the task says. Means over all option
    steps of all episodes are `option_reward`, r_kappa, and `last_reward`, which is what the thesis's figures are of:
    the published code keeps an option step's last low-level reward alone.
    """
    if not episodes:
        return {}
    columns: dict[str, list[float]] = {
        "return": [episode.returned for episode in episodes],
        "steps": [episode.steps for episode in episodes],
        "decisions": [episode.decisions for episode in episodes],
        "terminated": [episode.terminated for episode in episodes],
    }
    columns |= {name: [e.figures[name] for e in episodes] for name in episodes[0].figures if name not in columns}
    decisions = sum(episode.decisions for episode in episodes)
    return {name: float(np.mean(column)) for name, column in columns.items()} | {
        "option_reward": sum(episode.option_reward for episode in episodes) / decisions,
        "last_reward": sum(episode.last_reward for episode in episodes) / decisions,
    }
