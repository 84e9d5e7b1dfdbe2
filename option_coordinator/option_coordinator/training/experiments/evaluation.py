"""Evaluates policies: episodes and their averages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from option_coordinator.environments.option_env import OptionEnvironment
from option_coordinator.environments.roll_out import JointDecisionPolicy, OptionEpisode, play_episodes
from option_coordinator.policies.joint_policy import JointPolicy

DRAWS, MODE = "draws", "mode"
"""Ways to use a policy: samples (for Q-learning, with its final exploration), or most likely options."""
_SEED = 2_000_000


def fresh(episodes: int) -> range:
    """Return seeds of evaluation episodes: the same worlds for every policy, never used in training."""
    return range(_SEED, _SEED + episodes)


def evaluate(
    environment: OptionEnvironment, draws: JointPolicy, mode: JointPolicy, episodes: int, seed: int
) -> dict[str, dict[str, float]]:
    """Evaluate both uses of a policy, `DRAWS` and `MODE`, in the same episodes; see `summary`.

    Args:
        environment: Environment of the episodes.
        draws: Policy that samples its options.
        mode: Policy that takes its most likely options; with little observed, it may run in circles.
        episodes: Number of episodes per use.
        seed: Seed of the run, used for sampling; the worlds are the same for all runs.
    """
    seeds = fresh(episodes)
    choosers = {
        DRAWS: JointDecisionPolicy(draws, np.random.default_rng((_SEED, seed, 1))),
        MODE: JointDecisionPolicy(mode),
    }
    return {how: summary(list(play_episodes(environment, chooser, seeds))) for how, chooser in choosers.items()}


def summary(episodes: Sequence[OptionEpisode]) -> dict[str, float]:
    """Summarise episodes; empty if there are none.

    Means over episodes: `return`, `steps`, `decisions`, `terminated` and the task's metrics. Means over all option
    steps: `option_reward` (r_kappa) and `last_reward`, the quantity in the thesis's tables: the published code keeps
    only the last low-level reward of each option step.
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
