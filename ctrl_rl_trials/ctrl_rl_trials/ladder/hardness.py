"""Difficulty of a task: its optimal time, and how often an untrained policy reaches the goal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from ctrl_rl_learning.sb3 import FleetEnvironments

from ctrl_rl_core import NavigationTask, Outcome, ValueFunction, draw_starts
from ttr_reward_node import TimeToReach

SAMPLES = 10_240
"""Samples of the untrained policy."""
_DEVIATION = float(np.exp(-0.5))
"""Standard deviation of an untrained Gaussian policy's action, as in PPO's initial policy here; the mean is 0."""
_STARTS, _ROBOTS = 200, 16


@dataclass(frozen=True)
class Hardness:
    """Difficulty of a task.

    Attributes:
        optimal: Median time to reach from the task's starts [s]; None without a value function.
        unreachable: Share of the starts from which the goal is unreachable; None without a value function.
        limit: Time limit of an episode [s].
        ended: Number of episodes of the untrained policy, by outcome.
        samples: Number of samples in these episodes.
    """

    optimal: float | None
    unreachable: float | None
    limit: float
    ended: Mapping[str, int]
    samples: int

    @property
    def goals(self) -> int:
        """Number of episodes in which the untrained policy reached the goal."""
        return self.ended[Outcome.GOAL.name]


def measure_hardness(
    task: NavigationTask, value: ValueFunction | None, samples: int = SAMPLES, seed: int = 0
) -> Hardness:
    """Measure the difficulty of a task.

    Args:
        task: Task in an arena.
        value: Time to reach of the task; None if there is none.
        samples: Number of samples of the untrained policy.
        seed: Seed of starts and actions.

    Raises:
        SimulationError, LearningError: A fleet cannot simulate the task, or it has a corridor.
    """
    random = np.random.default_rng(seed)
    environments = FleetEnvironments(task, _ROBOTS)
    environments.seed(seed)
    environments.reset()
    ended: Counter[str] = Counter()
    for _ in range(samples // _ROBOTS):
        over, infos = environments.step(random.normal(0.0, _DEVIATION, (_ROBOTS, 2)))[2:]
        ended.update(info["outcome"] for info, done in zip(infos, over, strict=True) if done)
    optimal = unreachable = None
    if value is not None:
        system, world = task.system.build(), task.build_world()
        starts = [draw_starts(task, system, world, 1, task.robot.radius, random)[0] for _ in range(_STARTS)]
        times = TimeToReach(value).times(np.array(starts))
        known = np.isfinite(times)
        optimal, unreachable = float(np.median(times[known])) if known.any() else None, float(1.0 - known.mean())
    counts = {outcome.name: ended[outcome.name] for outcome in Outcome if outcome}
    return Hardness(
        optimal, unreachable, task.episode.steps * task.episode.time_step, counts, samples // _ROBOTS * _ROBOTS
    )
