"""PPO runs in the planar engine: with or without a shield, and against the filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from ctrl_rl_learning.sb3 import Environment, SimulatedRun, make_algorithm
from stable_baselines3.common.base_class import BaseAlgorithm

from ctrl_rl_core import NavigationTask, load_navigation_task
from ctrl_rl_safety.models.robot_model import ROBOTS, RobotModel
from ctrl_rl_safety.training.rewards import Approach, Attack
from ctrl_rl_safety.training.shield import ShieldOptions, shielded_environment
from ctrl_rl_safety.training.told_actions import ToldPPO
from ctrl_rl_safety.trials.episodes import CAR
from ctrl_rl_safety.trials.worlds import MOVER_SPEED, attacked_room

Told = Literal["none", "raw", "sent", "penalty"]
WAYS: tuple[Told, ...] = ("none", "raw", "sent", "penalty")


@dataclass(frozen=True)
class ShieldRun(SimulatedRun):
    """A policy trained on a task of the car, and evaluated with and without the filter.

    Attributes:
        task_name: Name of the task.
        way: "none" for no shield, or the treatment of corrections.
        seed: Random seed.
    """

    task_name: str
    way: Told
    seed: int

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task_name}-{self.way}-s{self.seed}"

    @property
    def method(self) -> str:
        """Name of the method in the table."""
        return "no shield" if self.way == "none" else f"shield, {self.way}"

    @property
    def task(self) -> NavigationTask:
        """The task."""
        return load_navigation_task(self.task_name)

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run for its result."""
        return {"task": self.task_name, "way": self.way, "seed": self.seed, "model": repr(CAR)}

    def environment(self, rate: int | None = None) -> Environment:
        """Create the training environment; if a rate is given, the one without a shield."""
        return self.checked(active=self.way != "none" and rate is None)

    def checked(self, active: bool) -> Environment:
        """Create the evaluation environment, with or without the filter."""
        told = "raw" if self.way == "none" else self.way
        task = self.task
        options = ShieldOptions(active, told)
        return shielded_environment(task, CAR, options, lambda environment: Approach(environment, task))

    def model(self, samples: int) -> BaseAlgorithm:
        """Create the untrained algorithm with its own environments, for this many samples."""
        kind = ToldPPO if self.way == "sent" else None
        return make_algorithm("ppo", self.environment, self.seed, samples, kind)


@dataclass(frozen=True)
class AttackRun(SimulatedRun):
    """An attacker that learns to cause contacts, in a room with boxes and movers.

    Attributes:
        robot: Robot to drive, a key of `ROBOTS`.
        seed: Random seed.
        bare: Whether to train without the filter, where contacts are possible.
    """

    robot: str
    seed: int
    bare: bool = False

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"attacker-{self.robot}-{'bare' if self.bare else 'filter'}-s{self.seed}"

    @property
    def method(self) -> str:
        """Name of the method in the table."""
        return f"attacker, {self.robot}"

    @property
    def task(self) -> NavigationTask:
        """The task: a room in which an attacker tries to cause contacts."""
        return attacked_room(self.robot, self._model)

    @property
    def _model(self) -> RobotModel:
        return ROBOTS[self.robot]

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run for its result."""
        return {"robot": self.robot, "seed": self.seed, "bare": self.bare, "model": repr(self._model)}

    def environment(self, _rate: int | None = None) -> Environment:
        """Create the environment that rewards contacts."""
        options = ShieldOptions(not self.bare, mover_speed=MOVER_SPEED)
        return shielded_environment(self.task, self._model, options, Attack)

    def model(self, samples: int) -> BaseAlgorithm:
        """Create the untrained algorithm with its own environments, for this many samples."""
        return make_algorithm("ppo", self.environment, self.seed, samples)
