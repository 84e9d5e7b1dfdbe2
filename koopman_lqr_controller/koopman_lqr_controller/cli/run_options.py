"""Options shared by `train` and `compare`: the length and folder of runs. Imports no torch."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from ctrl_rl_core.command import FolderToWrite
from ctrl_rl_core.old_names import note_old_name
from ctrl_rl_learning.study import ExperimentOptions, NotNegative, Positive, RunOptions

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.environments.task import BenchmarkTask
from koopman_lqr_controller.training.experiments.methods import Changes

if TYPE_CHECKING:
    from koopman_lqr_controller.training.experiments.runs import LearningRun

CONSOLIDATION = 30
"""Default number of episodes per round of consolidation."""


@dataclass(frozen=True, kw_only=True)
class LearningOptions(ExperimentOptions):
    """Options of a command that learns from interaction."""

    folder: FolderToWrite = Path("runs/koopman")
    """Folder of the runs; each run has a subfolder, from which it is resumed."""
    samples: Positive | None = None
    """Maximum number of actions of a run (default: the task's)."""
    chunks: NotNegative = 0
    """Old name of --samples, in units of --actions."""
    actions: NotNegative = 0
    """Actions between two evaluations; 0 for the task's."""
    set: Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE")] = ()
    """Settings of the learner, such as riccati_iterations=3."""
    episodes: Positive = 20
    """New episodes for the final evaluation of each policy."""
    consolidation: NotNegative = CONSOLIDATION
    """Episodes per round of consolidation; 0 for none."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Device of the networks. "cuda" is several times faster with --recipe model_based, but runs are not reproducible
    exactly."""

    @property
    def set_words(self) -> list[str]:
        """Values of all --set options."""
        return [word for words in self.set for word in words]

    def changes(self) -> Changes:
        """Return the changed settings.

        Raises:
            KoopmanError: A value is not a valid setting.
        """
        out: dict[str, int | float | str] = {}
        for text in self.set_words:
            name, separator, value = text.partition("=")
            if not (separator and value):
                raise KoopmanError(f"--set {text}: must be NAME=VALUE")
            out[name] = _value(value)
        return tuple(sorted(out.items()))

    def learning_runs(
        self,
        task: str,
        changes: Changes,
        words: Sequence[str],
        consolidation: int,
        learner: str = "koopman",
        keep: Literal["best", "last"] = "best",
        first_seed: int = 0,
    ) -> list[LearningRun]:
        """Return one run per seed; its policy records the command that reproduces it."""
        from koopman_lqr_controller.training.experiments.runs import LearningRun

        command = as_command("train", "--task", task, *words, "--first-seed")
        return [
            LearningRun(task, seed, changes, self.device, f"{command} {seed}", consolidation, learner, keep)
            for seed in range(first_seed, first_seed + self.seeds)
        ]

    def run_options(self, task: BenchmarkTask) -> RunOptions:
        """Return the run settings for a task."""
        if self.chunks:
            note_old_name("koopman_lqr_controller", "--chunks", "--samples")
        actions = self.actions or task.chunk
        chunks = math.ceil(self.samples / actions) if self.samples else self.chunks or task.chunks
        return RunOptions(self.folder, chunks, actions, task.evaluations, self.episodes)


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def given_words(options: Any, names: Sequence[str]) -> list[str]:
    """Return the named options of a dataclass that differ from their defaults, as command-line arguments."""
    defaults = {field.name: field.default for field in fields(options)}
    out: list[str] = []
    for name in names:
        value = getattr(options, name)
        if value != defaults[name]:
            out += [f"--{name}", *map(str, value if isinstance(value, tuple) else [value])]
    return out


def as_command(*words: str) -> str:
    """Return the command line that reproduces a run."""
    return shlex.join(["ros2", "run", "koopman_lqr_controller", *words])
