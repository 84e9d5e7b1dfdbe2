"""DAgger runs: the student drives, the expert labels each scan, and the student learns from all labels.

Ross, Gordon, Bagnell, "A reduction of imitation learning and structured prediction to no-regret online learning"
(AISTATS 2011).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, Result, load_navigation_task, task_digest
from ctrl_rl_learning.dagger.episode import LabelledSample, corridor_interface, drive_labelled
from ctrl_rl_learning.dagger.student import Student
from ctrl_rl_learning.study.results import collect_rows, curves_of, finished_runs, metric
from ctrl_rl_learning.study.run import IterationMetrics, ProgressCallback, Run, RunOptions
from ctrl_rl_learning.torch.checkpoints import load_arrays, restore_state, save_arrays, state_arrays

_UPDATES = 1500
_LAST_UPDATES = 10_000
_SEEDS = 1_000_000
"""Offset between the seeds of two runs; test episodes start at seed 0."""
_EXPERT_SHARE = 0.2
"""Share of episodes that the expert drives after the first iteration."""


class DaggerTrainer:
    """Trainer of one run, with the student and all samples so far."""

    def __init__(self, task: NavigationTask, seed: int, options: RunOptions) -> None:
        self._task, self._seed, self._options = task, seed, options
        self._interface = corridor_interface(task)
        torch.manual_seed(seed)
        self._student = Student(self._interface)
        self._seen = np.empty((0, self._interface.size), np.float32)
        self._wanted = np.empty((0, 2), np.float32)
        self._episodes = 0

    def iterate(self, curve: Sequence[IterationMetrics]) -> IterationMetrics:
        """Drive episodes and learn from all samples so far; the expert alone drives the first iteration."""
        random = np.random.default_rng((self._seed, len(curve)))
        samples: list[LabelledSample] = []
        ends = []
        while len(samples) < self._options.samples:
            taught = not curve or random.random() < _EXPERT_SHARE
            seed, student = (
                self._seed * _SEEDS + _SEEDS // 2 + self._episodes,
                None if taught else self._student.command,
            )
            episode = drive_labelled(self._task, self._interface, seed, student)
            self._episodes += 1
            samples += episode.samples
            if not taught or not curve:
                ends.append(episode.outcome == Outcome.GOAL.name)
        self._seen = np.concatenate((self._seen, [each.observation for each in samples]))
        self._wanted = np.concatenate((self._wanted, [each.wanted for each in samples]), dtype=np.float32)
        loss = self._learn(_UPDATES, random)
        return {"samples": len(self._seen), "evaluation": float(np.mean(ends)), "loss": loss}

    def _learn(self, updates: int, random: np.random.Generator) -> float:
        return self._student.fit(self._seen, self._wanted, updates, random)

    def save(self, path: Path, progress: Mapping[str, Any]) -> None:
        """Write a checkpoint."""
        arrays: dict[str, NDArray[Any]] = {"seen": self._seen, "wanted": self._wanted}
        arrays |= state_arrays({"student": self._student.network}, {"optimizer": self._student.optimizer})
        save_arrays(path, arrays, {"episodes": self._episodes, "progress": dict(progress)})

    def load(self, path: Path) -> dict[str, Any]:
        """Restore a checkpoint and return its progress."""
        arrays, header = load_arrays(path)
        self._seen, self._wanted, self._episodes = arrays.pop("seen"), arrays.pop("wanted"), int(header["episodes"])
        restore_state({"student": self._student.network}, {"optimizer": self._student.optimizer}, arrays)
        progress: dict[str, Any] = header["progress"]
        return progress

    def finish(self, folder: Path) -> dict[str, Any]:
        """Train longer on all samples, write the policy, and evaluate it in new episodes."""
        loss = self._learn(_LAST_UPDATES, np.random.default_rng((self._seed, _SEEDS)))
        ends = [
            drive_labelled(self._task, self._interface, seed, self._student.command).outcome
            for seed in range(self._options.final_evaluations)
        ]
        success = float(np.mean([end == Outcome.GOAL.name for end in ends]))
        manifest = {
            "task": self._task.name,
            "task_digest": task_digest(self._task),
            "method": "taught by the time to reach",
            "seed": self._seed,
            "samples": len(self._seen),
            "success": success,
        }
        self._student.actor(manifest).save(folder / "policy.safetensors")
        collisions = float(np.mean([end == Outcome.COLLISION.name for end in ends]))
        return {"success": success, "collisions": collisions, "loss": loss}


@dataclass(frozen=True)
class TaughtRun(Run):
    """Training run for a corridor policy from one seed.

    Attributes:
        task_name: Name or file of the task.
        seed: Seed of episodes, network and batches.
    """

    task_name: str
    seed: int

    @property
    def task(self) -> NavigationTask:
        """The task."""
        return load_navigation_task(self.task_name)

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task.name}-taught-s{self.seed}"

    @contextmanager
    def begin(self, options: RunOptions, tell: ProgressCallback) -> Iterator[DaggerTrainer]:  # noqa: ARG002 - one iteration is short
        """Yield the trainer before its first episode."""
        yield DaggerTrainer(self.task, self.seed, options)

    def fingerprint(self, options: RunOptions) -> Mapping[str, Any]:
        """Return the settings that must not change when a run resumes."""
        return {
            "task_digest": task_digest(self.task),
            "seed": self.seed,
            "samples": options.samples,
            "final_evaluations": options.final_evaluations,
        }

    def words(self, point: IterationMetrics) -> float | str:
        """Return the success rate of the student's own drives in this iteration."""
        return float(point["evaluation"])


_METRICS = (
    metric("success", "1", lambda result: float(result["success"])),
    metric("collisions", "1", lambda result: float(result["collisions"])),
    metric("processor time", "s", lambda result: float(result["cpu_seconds"])),
)


def collect(runs: Sequence[TaughtRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows of finished runs, with one value per seed for each metric, and their success `curves`."""
    found = finished_runs(runs, folder, lambda _: "taught by the time to reach")
    return collect_rows(found, _METRICS), {"curves": curves_of(found, success="evaluation")}
