"""A fine-tuning session on the robot: episodes, learning and a checkpoint after each, and tests at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from ctrl_rl_core.io import raise_as
from numpy.typing import NDArray

from ctrl_rl_core import FunctionDriver, Outcome, Step, drive
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.environment.robot_env import RobotEnv
from ctrl_rl_learning.on_robot.learning.fine_tuner import FineTuner
from ctrl_rl_learning.study.curves import Curves
from ctrl_rl_learning.torch.checkpoints import load_arrays, save_arrays

Vector = NDArray[np.float32]
REWARD_SCALE = 0.01
"""Factor that multiplies every reward before learning."""
_SEEDS_APART = 100_000
TEST_SEED = 1_000_000
_WANDER = 0.7
"""Correlation of the exploration noise between consecutive steps."""


@dataclass
class EpisodeLog:
    """Summary of one episode.

    Attributes:
        outcome: Name of the outcome; "FENCE" if the robot left the arena.
        steps: Number of steps.
        seconds: Time that the robot drove [s].
        missed: Number of missed steps.
        late: Maximum delay of a step [s].
        age: Maximum age of a scan [s].
        late_scans: Number of scans that arrived too late or out of order.
        operator: Number of steps in which the operator drove.
        changed: Mean fraction of the commands that the safety filter changed.
        total: Undiscounted return.
        losses: Mean losses of the updates after the episode, by name.
    """

    outcome: str = Outcome.RUNNING.name
    steps: int = 0
    seconds: float = 0.0
    missed: int = 0
    late: float = 0.0
    age: float = 0.0
    late_scans: int = 0
    operator: int = 0
    changed: float = 0.0
    total: float = 0.0
    losses: dict[str, float] = field(default_factory=dict)

    def point(self) -> dict[str, Any]:
        """Return the episode as a point of the learning curves."""
        return {**asdict(self), "evaluation": float(self.outcome == Outcome.GOAL.name), "return": self.total}

    def add(self, reward: float, info: Mapping[str, Any]) -> None:
        """Add a step, given its reward and info."""
        self.total += reward
        self.changed += (info["changed"] - self.changed) / (self.steps + 1)
        self.outcome, self.steps, self.seconds = info["outcome"], self.steps + 1, self.seconds + info["duration"]
        self.missed, self.late_scans = self.missed + info["missed"], self.late_scans + info["late_scans"]
        self.late, self.age = max(self.late, info["late"]), max(self.age, info["age"])
        self.operator += info["operator"] > 0.0


class Session:
    """Fine-tuning session of one policy on one robot.

    Attributes:
        episodes: Logs of all episodes so far.
    """

    def __init__(
        self, environment: RobotEnv, tuner: FineTuner, folder: Path, seed: int, terms: Mapping[str, Any]
    ) -> None:
        """Create the session, resuming from a checkpoint if the folder has one.

        Args:
            environment: Environment of the robot.
            tuner: Policy that learns.
            folder: Folder of checkpoint and policies.
            seed: Seed of starts and exploration.
            terms: Settings that a checkpoint must match, as JSON.

        Raises:
            LearningError: The checkpoint is damaged, or belongs to different settings.
        """
        self._environment, self._tuner, self._folder, self._seed = environment, tuner, folder, seed
        self._terms = dict(terms)
        self._checkpoint = folder / "checkpoint.safetensors"
        self.episodes: list[EpisodeLog] = []
        if self._checkpoint.exists():
            with raise_as(LearningError, self._checkpoint, "delete it to start over"):
                arrays, header = load_arrays(self._checkpoint)
                if header.get("terms") != self._terms:
                    raise LearningError(f"belongs to different settings, {header.get('terms')}: give another --folder")
                try:
                    tuner.restore(arrays)
                    self.episodes = [EpisodeLog(**each) for each in header["episodes"]]
                except (KeyError, RuntimeError, TypeError, ValueError) as error:
                    raise LearningError(f"belongs to another policy ({type(error).__name__})") from None

    @property
    def seconds(self) -> float:
        """Driving time so far [s]."""
        return sum(each.seconds for each in self.episodes)

    def learn(self, seconds: float, tell: Callable[[EpisodeLog], object]) -> None:
        """Drive and learn until the driving time is reached [s], then finish the current episode.

        Raises:
            LearningError: The robot does not answer; the checkpoint holds all earlier episodes.
        """
        if self.seconds >= seconds:
            return
        with Curves(self._folder, [each.point() for each in self.episodes]) as curves:
            while self.seconds < seconds:
                number = len(self.episodes)
                random = np.random.default_rng((self._seed, number))
                torch.manual_seed(self._seed * _SEEDS_APART + number)
                log = self._drive(self._seed * _SEEDS_APART + number, _Explorer(self._tuner, random), remember=True)
                log.losses = self._tuner.learn(log.steps, random)
                self.episodes.append(log)
                self._save()
                curves.add(log.point())
                tell(log)

    def test(self, episodes: int, tell: Callable[[EpisodeLog], object]) -> list[EpisodeLog]:
        """Return test episodes of the current policy without exploration; every policy gets the same starts."""
        actor = self._tuner.to_actor({})
        out = []
        for number in range(episodes):
            log = self._drive(
                TEST_SEED + number, lambda seen: actor.scaled_action((seen - actor.middle) / actor.unit), remember=False
            )
            out.append(log)
            tell(log)
        return out

    def save_policy(self) -> None:
        """Write policy.safetensors for the policy node."""
        told = {"fine_tuned": {"seconds": self.seconds, "episodes": len(self.episodes)}}
        self._tuner.to_actor(told).save(self._folder / "policy.safetensors")

    def _drive(self, seed: int, act: Callable[[Vector], Vector], remember: bool) -> EpisodeLog:
        environment, log = self._environment, EpisodeLog()
        seen = np.empty(0, np.float32)

        def note(step: Step[Vector]) -> None:
            nonlocal seen
            if step.command is not None:
                log.add(step.reward, step.info)
                if remember:
                    duration = step.info["duration"] / environment.period
                    discount = 0.0 if step.terminated else self._tuner.settings.discount**duration
                    action, by_operator = step.info["action"], step.info["operator"] > 0.0
                    self._tuner.add(seen, action, REWARD_SCALE * step.reward, step.sensors, discount, by_operator)
            seen = step.sensors

        drive(environment, FunctionDriver(act), seeds=(seed,), watch=note)
        return log

    def _save(self) -> None:
        header = {"terms": self._terms, "episodes": [asdict(each) for each in self.episodes]}
        save_arrays(self._checkpoint, self._tuner.arrays(), header)
        self.save_policy()


class _Explorer:
    """Policy with noise that persists for a few steps, since noise in single steps hardly moves a robot."""

    def __init__(self, tuner: FineTuner, random: np.random.Generator) -> None:
        self._tuner, self._random, self._noise = tuner, random, np.zeros(2)

    def __call__(self, seen: Vector) -> Vector:
        fresh = np.sqrt(1.0 - _WANDER**2) * self._tuner.settings.noise * self._random.normal(size=2)
        self._noise = _WANDER * self._noise + fresh
        return np.clip(self._tuner.act(seen) + self._noise, -1.0, 1.0).astype(np.float32)
