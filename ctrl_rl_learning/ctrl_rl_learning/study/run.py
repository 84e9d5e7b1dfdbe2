"""A run: a method that learns a task from one seed, the settings that many runs share, and what a run leaves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol

from ctrl_rl_core.io import Anything, Schema, one_line, raise_as, read_json, short_path
from pydantic import ConfigDict, Field, field_validator

from ctrl_rl_learning.errors import LearningError

IterationMetrics = dict[str, Any]
"""Figures of one iteration of a curve, as JSON."""
ProgressCallback = Callable[[int, "float | str"], None]
"""Takes the iterations done, and a success rate or other words on how a run goes. It may be called more than once for
an iteration, where something else takes long."""


@dataclass(frozen=True)
class RunOptions:
    """Settings that all runs of an experiment share.

    Attributes:
        folder: Folder in which each run has a folder of its own.
        iterations: Number of iterations, at most.
        samples: Number of samples in an iteration; 0 where data are given.
        evaluations: Number of episodes after each iteration.
        final_evaluations: Number of episodes after the last iteration.
    """

    folder: Path
    iterations: int
    samples: int = 0
    evaluations: int = 0
    final_evaluations: int = 0


class Trainer(Protocol):
    """A learner between two iterations."""

    def iterate(self, curve: Sequence[IterationMetrics], /) -> IterationMetrics:
        """Learn for one iteration more than the curve has and return its figures."""

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint; `progress` is JSON that belongs to it."""

    def load(self, path: Path, /) -> dict[str, Any]:
        """Go on from a checkpoint and return its `progress`.

        Raises:
            Exception: One of `trainer.UNUSABLE`, if the file cannot be read or belongs to another learner.
        """

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Write the learnt policy into the run's folder and return figures for the result, as JSON."""


class Run(ABC):
    """All that defines a run, and nothing that cannot be sent to another process; subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the run and of its folder."""

    @abstractmethod
    def begin(self, options: RunOptions, tell: ProgressCallback) -> AbstractContextManager[Trainer]:
        """Return the learner as it is before the first iteration; it is closed at the end."""

    @abstractmethod
    def fingerprint(self, options: RunOptions) -> Mapping[str, Any]:
        """Return all that must stay the same for a run to go on, as JSON.

        A run whose fingerprint does not name `iterations` may go on to more of them after it was cut off.
        """

    @abstractmethod
    def words(self, point: IterationMetrics) -> float | str:
        """Return a success rate, or words, on how an iteration went."""

    def should_stop(self, curve: Sequence[IterationMetrics]) -> bool:  # noqa: ARG002 - for those that override it
        """Return whether learning ends before all iterations are done."""
        return False

    def check(self, folder: Path, result: Mapping[str, Any]) -> None:  # noqa: B027 - most have nothing to check
        """Refuse a finished run whose files were changed.

        Raises:
            CtrlRlError: Names the file.
        """


def find_method(methods: Mapping[str, Any], name: str, error: type[Exception] = LearningError) -> Any:
    """Return a method of a package's table.

    Raises:
        Exception: `error`, if the table has no such method.
    """
    if name not in methods:
        raise error(f"no method '{name}': there are {', '.join(methods)}")
    return methods[name]


class _Point(Schema):
    """What a curve says of an iteration: the learner's own words, and these."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    seconds: float = 0.0
    cpu_seconds: float = 0.0


class Progress(Schema):
    """What a checkpoint says of a run, besides what its learner keeps for itself."""

    model_config = ConfigDict(extra="allow")

    run: Anything
    curve: Annotated[list[Anything], Field(max_length=1_000_000)]

    @field_validator("curve")
    @classmethod
    def _points(cls, curve: list[Anything]) -> list[Anything]:
        for point in curve:
            _Point.model_validate(point)
        return curve


class Finished(Progress):
    """What a finished run leaves."""

    cpu_seconds: float = 0.0


def result_file(folder: Path, run: Run) -> Path:
    """Return the file that says that a run is finished, and how it went."""
    return folder / run.name / "result.json"


def read_result(file: Path) -> dict[str, Any]:
    """Return what a finished run left, see `result_file`: at least its `run` and its `curve`.

    Raises:
        LearningError: the file is damaged.
    """
    with raise_as(LearningError, file, "is not what a finished run leaves: delete it to have it learnt again"):
        result: dict[str, Any] = read_json(file)
        Finished.model_validate(result)
    return result


def check_same(file: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse a file of a run that was another one.

    Raises:
        LearningError: names the first difference.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise LearningError(
                f"{short_path(file)}: was made with {name} {one_line(before.get(name), 100)}, now it is "
                f"{one_line(value, 100)}: use another folder, or delete it"
            )
