"""A run: a method that learns a task from one seed, and the settings that many runs share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ctrl_rl_learning.errors import LearningError

Point = dict[str, Any]
"""Figures of one iteration of a curve, as JSON."""
Tell = Callable[[int, "float | str"], None]
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


class Learning(Protocol):
    """A learner between two iterations."""

    def iterate(self, curve: Sequence[Point], /) -> Point:
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
    def begin(self, options: RunOptions, tell: Tell) -> AbstractContextManager[Learning]:
        """Return the learner as it is before the first iteration; it is closed at the end."""

    @abstractmethod
    def terms(self, options: RunOptions) -> Mapping[str, Any]:
        """Return all that must stay the same for a run to go on, as JSON.

        A run whose terms do not name `iterations` may go on to more of them after it was cut off.
        """

    @abstractmethod
    def words(self, point: Point) -> float | str:
        """Return a success rate, or words, on how an iteration went."""

    def should_stop(self, curve: Sequence[Point]) -> bool:  # noqa: ARG002 - for those that override it
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
