"""What all kinds of runs have in common: a name, a folder, how long they go, and when what lies there may be taken."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ctrl_rl_training.errors import TrainingError

ROLL_OUT = 2048
"""Samples between two updates of PPO; TRPO updates twice as often."""
ITERATION = 5 * ROLL_OUT
"""Samples of an iteration."""


class Named(Protocol):
    """Anything that is run and has a folder of its own."""

    @property
    def name(self) -> str:
        """Name of it, and of its folder."""


@dataclass(frozen=True)
class Options:
    """How runs go.

    Attributes:
        folder: where each has a folder of its own.
        iterations: how many.
        samples: of an iteration.
        evaluations: episodes after each iteration.
        final_evaluations: episodes after the last one.
    """

    folder: Path
    iterations: int = 10
    samples: int = ITERATION
    evaluations: int = 20
    final_evaluations: int = 50


Report = Callable[[Any, int, float], None]
"""What is told of an iteration: the run, the iterations done, and how the evaluation went, as a success rate."""


def result_file(folder: Path, run: Named) -> Path:
    """Return the file that says that a run is finished, and how it went."""
    return folder / run.name / "result.json"


def check_same(file: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse a file that was made with other terms than those of now.

    Raises:
        TrainingError: it was; the message says which.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise TrainingError(
                f"{file}: was made with {name} {before.get(name)}, now it is {value}: use another folder, or delete it"
            )
