"""The runs of the ladder: a task, a way, a learner, a seed; learnt in the planar engine, checked in PyBullet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ctrl_rl_training.experiments.run import find_method
from ctrl_rl_training.sb3.algorithms import make_algorithm
from ctrl_rl_training.sb3.environment import Environment, make_environment
from ctrl_rl_training.sb3.training import SimulatedRun
from oc_baseline_node.training.baselines.policy_gradient import BaselinePolicy, CorrectedPolicy
from stable_baselines3.common.base_class import BaseAlgorithm
from ttr_reward_node.training.training import RewardWrapper

from ctrl_rl_benchmarks.errors import BenchmarkError
from ctrl_rl_benchmarks.ladder.task_list import load_ladder_task
from ctrl_rl_benchmarks.ways.baseline import TimeToReachBaseline, fit_critic
from ctrl_rl_benchmarks.ways.demonstrations import demonstrate, teach
from ctrl_rl_benchmarks.ways.methods import GAMMA, MAIN, WAYS, Way
from ctrl_rl_benchmarks.ways.pay import PAYS, PayWrapper
from ctrl_rl_benchmarks.ways.potential import DistanceInSeconds, Potential, TimeToReach
from ctrl_rl_benchmarks.ways.starts import GrowingStarts, levels
from ctrl_rl_core import NavigationTask
from ttr_reward_node import load_value, make_reward


@dataclass(frozen=True)
class LadderRun(SimulatedRun):
    """A run of the ladder.

    Attributes:
        task_name: Name of the task, or its file.
        way_name: One of `WAYS`.
        learner: One of `LEARNERS`.
        seed: Seed of everything random.
        value: File of the task's time to reach.
        engine: Physics engine of learning; policies are checked in PyBullet at the rate of deployed robots.
    """

    task_name: str
    way_name: str
    learner: str
    seed: int
    value: Path
    engine: str = "planar"

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task.name}-{self.way_name}-{self.learner}-s{self.seed}"

    @property
    def method(self) -> str:
        """Name of the method in the table."""
        return f"{self.task.name}: {self.way_name}, {self.learner}"

    @property
    def way(self) -> Way:
        """The way.

        Raises:
            BenchmarkError: There is no such way.
        """
        way: Way = find_method(WAYS, self.way_name, BenchmarkError)
        return way

    @property
    def task(self) -> NavigationTask:
        """The task."""
        return load_ladder_task(self.task_name)

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run in its result."""
        return {
            "task": self.task.name,
            "way": self.way_name,
            "learner": self.learner,
            "seed": self.seed,
            "engine": self.engine,
            "value_digest": load_value(self.value).digest if self.way.needs_value else None,
        }

    def environment(self, rate: int | None = None) -> Environment:
        """Return the environment that pays what the way says; in PyBullet where a rate is given."""
        return self._environment(rate, training=False)

    def _environment(self, rate: int | None, training: bool) -> Environment:
        way, task = self.way, self.task
        wrappers: list[Any] = []
        if training and way.starts == "grow":
            states, times = _levels(self.task_name, self.value)
            wrappers.append(lambda environment: GrowingStarts(environment, states, times))
        if way.reward in ("distance", "ttr"):
            names = {"distance": "distance_0", "ttr": "ttr"}
            reward = make_reward(names[way.reward], task, load_value(self.value) if way.reward == "ttr" else None)
            wrappers.append(lambda environment: RewardWrapper(environment, reward))
        elif way.reward != "none":
            potential: Potential = (
                DistanceInSeconds(task) if way.of == "distance" else TimeToReach(load_value(self.value))
            )
            make = PAYS[way.reward]
            wrappers.append(lambda environment: PayWrapper(environment, potential, make(potential.longest, GAMMA)))
        return make_environment(task, rate, *wrappers, engine=self.engine if rate is None else "auto")

    def model(self, samples: int) -> BaseAlgorithm:
        """Return the untrained algorithm with its own environments, for so many samples."""
        way = self.way
        changes: dict[str, Any] = {"gamma": GAMMA}
        if self.learner == "ppo":
            changes["gae_lambda"] = way.gae_lambda
        baseline = None
        if way.baseline != "learnt":
            baseline = TimeToReachBaseline(TimeToReach(load_value(self.value)), self.task, GAMMA)
        if way.baseline == "frozen":
            changes |= {"policy": BaselinePolicy, "policy_kwargs": {"baseline": baseline}, "vf_coef": 0.0}
        elif way.baseline == "corrected":
            changes |= {"policy": CorrectedPolicy, "policy_kwargs": {"baseline": baseline}}
        model = make_algorithm(
            self.learner, lambda: self._environment(None, training=True), self.seed, samples, **changes
        )
        if way.baseline == "begins" and baseline is not None:
            fit_critic(model, baseline, self.seed)
        if way.demonstrations:
            environment = self.environment()
            potential = TimeToReach(load_value(self.value))
            seen, done = demonstrate(environment, self.task, potential, self.seed)
            environment.close()
            teach(model, seen, done, self.seed)
            model.num_timesteps += len(seen)
        return model


def ladder_runs(
    tasks: Sequence[str],
    ways: Sequence[str],
    learners: Sequence[str],
    seeds: int,
    values: Mapping[str, Path],
    engine: str = "planar",
) -> list[LadderRun]:
    """Return all runs, those that tell most first: the main ways by PPO, then by the other learners, then the rest."""
    ordered = sorted(ways, key=list(WAYS).index)
    return [
        LadderRun(task, way, learner, seed, values[task], engine)
        for main in (True, False)
        for learner in learners
        for seed in range(seeds)
        for way in ordered
        for task in tasks
        if learner in WAYS[way].learners and (way in MAIN) == main
    ]


@lru_cache(maxsize=2)
def _levels(task_name: str, value: Path) -> Any:
    return levels(load_ladder_task(task_name), TimeToReach(load_value(value)))
