"""DAgger runs: the student drives, the expert labels each scan, and the student learns from all labels.

Ross, Gordon, Bagnell, "A reduction of imitation learning and structured prediction to no-regret online learning"
(AISTATS 2011).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, Result, load_navigation_task, task_digest
from ctrl_rl_learning.dagger.clutter import KINDS, Corridor, draw_corridor
from ctrl_rl_learning.dagger.episode import DaggerEpisode, LabelledSample, corridor_interface, drive_labelled
from ctrl_rl_learning.dagger.expert import wheeled
from ctrl_rl_learning.dagger.student import Student
from ctrl_rl_learning.study.results import Metric, collect_rows, curves_of, finished_runs, metric
from ctrl_rl_learning.study.run import IterationMetrics, ProgressCallback, Run, RunOptions
from ctrl_rl_learning.torch.checkpoints import load_arrays, restore_state, save_arrays, state_arrays

_UPDATES = 1500
_LAST_UPDATES = 10_000
_SEEDS = 1_000_000
"""Offset between the seeds of two runs; test episodes start at seed 0."""
_EXPERT_SHARE = 0.2
"""Share of episodes that the expert drives after the first iteration."""


class DaggerTrainer:
    """Trainer of one run, with the student and all samples so far.

    Args:
        task: Task with a corridor.
        seed: Seed of episodes, network and batches.
        options: Settings of the run.
        clutter: Whether episodes draw legs and openings as well.
    """

    def __init__(self, task: NavigationTask, seed: int, options: RunOptions, clutter: bool = False) -> None:
        self._task, self._seed, self._options, self._clutter = task, seed, options, clutter
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
            episode, _ = self._drive(seed, student)
            self._episodes += 1
            samples += episode.samples
            if not taught or not curve:
                ends.append(episode.outcome == Outcome.GOAL.name)
        self._seen = np.concatenate((self._seen, [each.observation for each in samples]))
        self._wanted = np.concatenate((self._wanted, [each.wanted for each in samples]), dtype=np.float32)
        loss = self._learn(_UPDATES, random)
        return {"samples": len(self._seen), "evaluation": float(np.mean(ends)), "loss": loss}

    def _drive(self, seed: int, student: Callable[[Any], Any] | None) -> tuple[DaggerEpisode, str]:
        """Drive the episode of a seed; return it with its kind of corridor."""
        corridor = Corridor(self._task, None, KINDS[0])
        if self._clutter:
            corridor = draw_corridor(self._task, wheeled(self._task).through_gaps, seed)
        episode = drive_labelled(corridor.task, self._interface, seed, student, corridor.width)
        return episode, corridor.kind

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
        drives = [self._drive(seed, self._student.command) for seed in range(self._options.final_evaluations)]
        ends = [episode.outcome for episode, _ in drives]
        success = float(np.mean([end == Outcome.GOAL.name for end in ends]))
        of_kind = {
            kind: float(np.mean([each.outcome == Outcome.GOAL.name for each, drawn in drives if drawn == kind]))
            for kind in sorted({kind for _, kind in drives})
        }
        manifest = {
            "task": self._task.name,
            "task_digest": task_digest(self._task),
            "method": "taught by the time to reach",
            "clutter": self._clutter,
            "seed": self._seed,
            "samples": len(self._seen),
            "success": success,
        }
        self._student.actor(manifest).save(folder / "policy.safetensors")
        collisions = float(np.mean([end == Outcome.COLLISION.name for end in ends]))
        return {"success": success, "collisions": collisions, "loss": loss, "success by kind": of_kind}


@dataclass(frozen=True)
class TaughtRun(Run):
    """Training run for a corridor policy from one seed.

    Attributes:
        task_name: Name or file of the task.
        seed: Seed of episodes, network and batches.
        clutter: Whether episodes draw legs and openings as well.
    """

    task_name: str
    seed: int
    clutter: bool = False

    @property
    def task(self) -> NavigationTask:
        """The task."""
        return load_navigation_task(self.task_name)

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        return f"{self.task.name}-{'cluttered-' if self.clutter else ''}taught-s{self.seed}"

    @contextmanager
    def begin(self, options: RunOptions, tell: ProgressCallback) -> Iterator[DaggerTrainer]:  # noqa: ARG002 - one iteration is short
        """Yield the trainer before its first episode."""
        yield DaggerTrainer(self.task, self.seed, options, self.clutter)

    def fingerprint(self, options: RunOptions) -> Mapping[str, Any]:
        """Return the settings that must not change when a run resumes."""
        return {
            "task_digest": task_digest(self.task),
            "seed": self.seed,
            "samples": options.samples,
            "final_evaluations": options.final_evaluations,
            **({"clutter": True} if self.clutter else {}),
        }

    def words(self, point: IterationMetrics) -> float | str:
        """Return the success rate of the student's own drives in this iteration."""
        return float(point["evaluation"])


def _of_kind(kind: str) -> Callable[[Mapping[str, Any]], float]:
    return lambda result: float(result["success by kind"].get(kind, math.nan))


_METRICS: tuple[Metric, ...] = (
    metric("success", "1", lambda result: float(result["success"])),
    metric("collisions", "1", lambda result: float(result["collisions"])),
    metric("processor time", "s", lambda result: float(result["cpu_seconds"])),
)


def collect(runs: Sequence[TaughtRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows of finished runs, with one value per seed for each metric, and their success `curves`."""
    found = finished_runs(
        runs, folder, lambda run: "taught by the time to reach" + (", cluttered corridors" if run.clutter else "")
    )
    metrics = _METRICS
    if any(run.clutter for run in runs):
        metrics += tuple(metric(f"success, {kind}", "1", _of_kind(kind)) for kind in KINDS)
    return collect_rows(found, metrics), {"curves": curves_of(found, success="evaluation")}
