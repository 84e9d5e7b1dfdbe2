"""Runs of the ladder (task, way, learner, seed), trained in the planar engine and tested in PyBullet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ctrl_rl_learning.sb3 import (
    Environment,
    FleetEnvironments,
    FleetReward,
    SimulatedRun,
    make_algorithm,
    make_environment,
    number_of_environments,
)
from ctrl_rl_learning.study import find_method
from oc_baseline_node.training import BaselinePolicy, CorrectedPolicy
from stable_baselines3.common.base_class import BaseAlgorithm
from ttr_reward_node.rewards import PAYS, PER_SECOND, Potential, PotentialReward
from ttr_reward_node.training import StateReward

from ctrl_rl_core import NavigationTask
from ctrl_rl_trials.errors import TrialError
from ctrl_rl_trials.ladder.task_list import load_ladder_task
from ctrl_rl_trials.shaping.baseline import TimeToReachBaseline, demonstrate, fit_critic, teach
from ctrl_rl_trials.shaping.geodesic import GeodesicInSeconds
from ctrl_rl_trials.shaping.starts import GrowingStarts, levels
from ctrl_rl_trials.shaping.time_to_go import DistanceInSeconds, TimeToGo
from ctrl_rl_trials.shaping.variants import GAMMA, MAIN, WAYS, Variant
from ttr_reward_node import TimeToReach, load_value, make_reward


@dataclass(frozen=True)
class LadderRun(SimulatedRun):
    """Run of the ladder.

    Attributes:
        task_name: Name of the task, or its file.
        way_name: One of `WAYS`.
        learner: One of `LEARNERS`.
        seed: Seed of all random numbers.
        value: File of the task's time to reach, or folder of MPC's trajectories for a way that uses them.
    """

    task_name: str
    way_name: str
    learner: str
    seed: int
    value: Path

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task.name}-{self.way_name}-{self.learner}-s{self.seed}"

    @property
    def method(self) -> str:
        """Name of the method in the table."""
        return f"{self.task.name}: {self.way_name}, {self.learner}"

    @property
    def way(self) -> Variant:
        """The way.

        Raises:
            TrialError: There is no such way.
        """
        way: Variant = find_method(WAYS, self.way_name, TrialError)
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
            "value_digest": self._value_digest(),
        }

    def _value_digest(self) -> str | None:
        if self.way.needs_mpc:
            return TimeToGo(self.value, self.task).digest
        return load_value(self.value).digest if self.way.needs_value else None

    def environment(self, rate: int | None = None) -> Environment:
        """Return the task's environment in PyBullet (MuJoCo if PyBullet is missing), with the task's own rewards."""
        return make_environment(self.task, rate)

    @property
    def in_fleet(self) -> bool:
        """Whether training uses a fleet, as for all tasks of the ladder."""
        return True

    def fleet_reward(self, robots: int) -> FleetReward | None:
        """Return the way's reward for a fleet of the given size."""
        way, task = self.way, self.task
        if way.reward == "none":
            return None
        if way.reward in ("distance", "ttr"):
            names = {"distance": "distance_0", "ttr": "ttr"}
            return StateReward(
                make_reward(names[way.reward], task, load_value(self.value) if way.reward == "ttr" else None)
            )
        potential = self._potential()
        return PotentialReward(potential, PAYS[way.reward](potential.longest, PER_SECOND, GAMMA), robots)

    def _potential(self) -> Potential:
        if self.way.of == "distance":
            return DistanceInSeconds(self.task)
        if self.way.of == "geodesic":
            return _geodesic(self.task_name)
        return TimeToGo(self.value, self.task) if self.way.needs_mpc else TimeToReach(load_value(self.value))

    def environments(self, algorithm: str) -> FleetEnvironments:
        """Return an algorithm's fleet, with the way's start states."""
        robots = number_of_environments(algorithm)
        starts = None
        if self.way.starts == "grow":
            states, times = _levels(self.task_name, self.value)
            starts = GrowingStarts(states, times, robots)
        return FleetEnvironments(self.task, robots, self.fleet_reward(robots), starts)

    def model(self, samples: int) -> BaseAlgorithm:
        """Return the untrained algorithm with its environments, for a total number of samples."""
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
        model = make_algorithm(self.learner, self.environments(self.learner), self.seed, samples, **changes)
        if way.baseline == "begins" and baseline is not None:
            fit_critic(model, baseline, self.seed)
        if way.demonstrations:
            potential = TimeToReach(load_value(self.value))
            seen, done = demonstrate(self.environments(self.learner), self.task, potential, self.seed)
            teach(model, seen, done, self.seed)
            model.num_timesteps += len(seen)
        return model


def ladder_runs(
    tasks: Sequence[str],
    ways: Sequence[str],
    learners: Sequence[str],
    seeds: int,
    values: Mapping[str, Path],
    mpc_values: Mapping[str, Path] = MappingProxyType({}),
) -> list[LadderRun]:
    """Return all runs, the most informative first: the main ways with PPO, then with other learners, then the rest.

    Args:
        tasks: Names of tasks, or their files.
        ways: Names of ways.
        learners: Names of learners.
        seeds: Number of seeds.
        values: File of each task's time to reach.
        mpc_values: Folder of MPC's trajectories of each task, for the ways that use them.
    """
    ordered = sorted(ways, key=list(WAYS).index)
    return [
        LadderRun(task, way, learner, seed, (mpc_values if WAYS[way].needs_mpc else values)[task])
        for main in (True, False)
        for learner in learners
        for seed in range(seeds)
        for way in ordered
        for task in tasks
        if learner in WAYS[way].learners and (way in MAIN) == main
    ]


@lru_cache(maxsize=2)
def _geodesic(task_name: str) -> GeodesicInSeconds:
    return GeodesicInSeconds(load_ladder_task(task_name))


@lru_cache(maxsize=2)
def _levels(task_name: str, value: Path) -> Any:
    return levels(load_ladder_task(task_name), TimeToReach(load_value(value)))
