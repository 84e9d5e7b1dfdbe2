"""A training run: a method that learns a task from one seed, the settings of an experiment, and a run's files."""

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
"""Figures of one iteration, as JSON."""
ProgressCallback = Callable[[int, "float | str"], None]
"""Called with the number of finished iterations, and a success rate or a message. A long iteration may call it more
than once."""


@dataclass(frozen=True)
class RunOptions:
    """Settings that all runs of an experiment share.

    Attributes:
        folder: Folder with one subfolder per run.
        iterations: Maximum number of iterations.
        samples: Number of samples per iteration; 0 when learning from given data.
        evaluations: Number of episodes after each iteration.
        final_evaluations: Number of episodes after the last iteration.
    """

    folder: Path
    iterations: int
    samples: int = 0
    evaluations: int = 0
    final_evaluations: int = 0


class Trainer(Protocol):
    """Learner that `train` advances one iteration at a time."""

    def iterate(self, curve: Sequence[IterationMetrics], /) -> IterationMetrics:
        """Learn for one more iteration than the curve has, and return its figures."""

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint that includes `progress`, as JSON."""

    def load(self, path: Path, /) -> dict[str, Any]:
        """Restore a checkpoint and return its `progress`.

        Raises:
            Exception: One of `trainer.UNUSABLE`, if the file cannot be read or belongs to another learner.
        """

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Write the learnt policy into the run's folder and return figures for the result, as JSON."""


class Run(ABC):
    """Definition of a run, which can be pickled for another process; subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the run and of its folder."""

    @abstractmethod
    def begin(self, options: RunOptions, tell: ProgressCallback) -> AbstractContextManager[Trainer]:
        """Yield the trainer before its first iteration, and close it at the end."""

    @abstractmethod
    def fingerprint(self, options: RunOptions) -> Mapping[str, Any]:
        """Return the settings that must not change when a run resumes, as JSON.

        An interrupted run may resume with more iterations if its fingerprint does not include `iterations`.
        """

    @abstractmethod
    def words(self, point: IterationMetrics) -> float | str:
        """Return a success rate or a message that summarises an iteration."""

    def should_stop(self, curve: Sequence[IterationMetrics]) -> bool:  # noqa: ARG002 - for those that override it
        """Return whether to stop before all iterations are done."""
        return False

    def check(self, folder: Path, result: Mapping[str, Any]) -> None:  # noqa: B027 - most have nothing to check
        """Check that nobody changed the files of a finished run.

        Raises:
            CtrlRlError: A file was changed; the message names it.
        """


def find_method(methods: Mapping[str, Any], name: str, error: type[Exception] = LearningError) -> Any:
    """Return a method from a package's table by its name.

    Raises:
        Exception: `error`, if the table has no such method.
    """
    if name not in methods:
        raise error(f"no method '{name}': there are {', '.join(methods)}")
    return methods[name]


class _Point(Schema):
    """Schema of a curve's point: the learner's own figures, and the fields below."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    seconds: float = 0.0
    cpu_seconds: float = 0.0


class Progress(Schema):
    """Progress of a run in its checkpoint, apart from the learner's own state."""

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
    """Content of a finished run's result file."""

    cpu_seconds: float = 0.0


def result_file(folder: Path, run: Run) -> Path:
    """Return the path of a run's result file, which exists once the run is finished."""
    return folder / run.name / "result.json"


def read_result(file: Path) -> dict[str, Any]:
    """Return the content of a run's `result_file`, with at least `run` and `curve`.

    Raises:
        LearningError: The file is damaged.
    """
    with raise_as(LearningError, file, "is not the result of a finished run: delete it to train the run again"):
        result: dict[str, Any] = read_json(file)
        Finished.model_validate(result)
    return result


def check_same(file: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Check that a run's file was written with the current settings.

    Raises:
        LearningError: A setting differs; the message names the first one.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise LearningError(
                f"{short_path(file)}: was made with {name} {one_line(before.get(name), 100)}, now it is "
                f"{one_line(value, 100)}: use another folder, or delete it"
            )
