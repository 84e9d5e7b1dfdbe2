"""Training runs of thesis 3.2.3: each algorithm with each reward of Table 3.3, and progress, for several seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_learning.sb3 import (
    THESIS_ALGORITHMS,
    Environment,
    FleetReward,
    SimulatedRun,
    Vector,
    fits_fleet,
    make_algorithm,
    make_environment,
)
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from ctrl_rl_core import NavigationTask, Outcome, ValueFunction, load_navigation_task
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.rewards.progress import PER_SECOND, TimeToReach
from ttr_reward_node.rewards.rewards import PROGRESS, TRAINING_REWARDS, Reward, make_reward
from ttr_reward_node.training.time_to_reach_reward import TimeToReachReward
from ttr_reward_node.values.value_file import load_value

Array = NDArray[np.float64]


class RewardWrapper(gymnasium.Wrapper[Vector, Vector, Vector, Vector]):
    """Replaces the task's own reward by one of Table 3.3.

    Args:
        environment: Environment of a task of the suite.
        reward: Reward of the true state.
    """

    def __init__(self, environment: Environment, reward: Reward) -> None:
        super().__init__(environment)
        self._reward = reward

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Hold an action for the task's time step."""
        observation, paid, terminated, truncated, info = self.env.step(action)
        # The end of an episode pays the task's reward for all kinds: the environment has already paid it.
        if not (terminated or truncated):
            paid = self._reward(info["state"][None], np.array([Outcome.RUNNING]))[0]
        return observation, float(paid), terminated, truncated, info


class StateReward:
    """Pays the robots of a fleet a reward of Table 3.3 during an episode, as `RewardWrapper` does for one robot.

    Args:
        reward: Reward of the true states.
    """

    def __init__(self, reward: Reward) -> None:
        self._reward = reward

    def begin(self, robots: Sequence[int], states: Array) -> None:
        """Do nothing: the reward of a state does not depend on earlier states."""

    def pay(self, states: Array, outcomes: NDArray[np.intp], rewards: Array) -> Array:
        """Return the reward of a step for each robot (N,), see `FleetReward`."""
        return np.where(outcomes == Outcome.RUNNING, self._reward.intermediate(states), rewards)


def make_progress(task: NavigationTask, value: ValueFunction, rate: int | None = None) -> Environment:
    """Return the environment of a task with a reward for best progress in its time to reach, see `rewards.progress`."""
    make_reward("ttr", task, value)  # rejects a value that does not belong to the task
    return make_environment(
        task, rate, lambda environment: TimeToReachReward(environment, value, per_second=PER_SECOND)
    )


def make_rewarded(reward: Reward, rate: int | None = None) -> Environment:
    """Return the environment of the reward's task with that reward, at the physics rate `rate` [Hz] or the task's."""
    return make_environment(reward.task, rate, lambda environment: RewardWrapper(environment, reward))


_FIRST = (PROGRESS, "ttr", "sparse", "distance_10")
"""Rewards to train first, in case time runs out."""


@dataclass(frozen=True)
class RewardRun(SimulatedRun):
    """Training run with one algorithm and one reward.

    Attributes:
        task_name: Name of the task, or its file.
        algorithm: One of `ctrl_rl_learning.sb3.algorithm_names.ALGORITHMS`.
        reward: One of `TRAINING_REWARDS`.
        seed: Random seed.
        grid: File of the task's time-to-reach function, for "ttr" and "ttr_progress".
        engine: "planar" to train in a fleet if the task supports it, or "auto" for one robot at a time in PyBullet.
    """

    task_name: str
    algorithm: str
    reward: str
    seed: int
    grid: Path | None = None
    engine: str = "planar"

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task.name}-{self.algorithm}-{self.reward}-s{self.seed}"

    @property
    def task(self) -> NavigationTask:
        """Task of the run."""
        return load_navigation_task(self.task_name)

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run for its result."""
        value = _value(self.grid)
        return {
            "task": self.task.name,
            "algorithm": self.algorithm,
            "reward": self.reward,
            "seed": self.seed,
            "grid_digest": None if value is None else value.digest,
            **({"engine": self.engine} if self.in_fleet else {}),
        }

    @property
    def in_fleet(self) -> bool:
        """Whether the run trains in a fleet."""
        return self.engine == "planar" and fits_fleet(self.task)

    def environment(self, rate: int | None = None) -> Environment:
        """Return the task's environment with the reward of the run."""
        if self.reward == PROGRESS:
            return make_progress(self.task, self._time_to_reach(), rate)
        return make_rewarded(make_reward(self.reward, self.task, _value(self.grid)), rate)

    def fleet_reward(self, robots: int) -> FleetReward:
        """Return the reward for a fleet of `robots` robots."""
        if self.reward == PROGRESS:
            return TimeToReach(self._time_to_reach()).for_robots(robots)
        return StateReward(make_reward(self.reward, self.task, _value(self.grid)))

    def _time_to_reach(self) -> ValueFunction:
        value = _value(self.grid)
        if value is None:
            raise TimeToReachError(f"the reward '{PROGRESS}' needs the task's time to reach: solve the task first")
        return value

    def model(self, samples: int) -> BaseAlgorithm:
        """Return the untrained algorithm with its environments, for `samples` samples."""
        return make_algorithm(self.algorithm, self.environments(self.algorithm), self.seed, samples)


def reward_runs(
    task_name: str,
    algorithms: Sequence[str] = THESIS_ALGORITHMS,
    rewards: Sequence[str] = TRAINING_REWARDS,
    seeds: int = 5,
    grid: Path | None = None,
    engine: str = "planar",
) -> list[RewardRun]:
    """Return all runs of a task, the most important first."""
    ordered = sorted(rewards, key=lambda reward: _FIRST.index(reward) if reward in _FIRST else len(_FIRST))
    return [
        RewardRun(task_name, algorithm, reward, seed, grid if reward in ("ttr", PROGRESS) else None, engine)
        for reward in ordered
        for seed in range(seeds)
        for algorithm in algorithms
    ]


@lru_cache(maxsize=4)
def _value(grid: Path | None) -> ValueFunction | None:
    return None if grid is None else load_value(grid)
