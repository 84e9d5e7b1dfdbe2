"""Table of benchmark drives by method, stored in a results file after every drive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from ctrl_rl_core.io import read_experiment, results_lock
from pydantic import Field, TypeAdapter, ValidationError

from ctrl_rl_core import Result, write_results
from ctrl_rl_trials.barn.drive import LOW_ROS2, BarnDrive, End
from ctrl_rl_trials.barn.scenarios import MOVING, STATIC
from ctrl_rl_trials.errors import TrialError

_World = Annotated[int, Field(ge=0, lt=STATIC + MOVING)]
_Number = Annotated[float, Field(ge=0.0, le=1e4)]
_DRIVES = TypeAdapter(dict[str, list[tuple[_World, End, _Number, _Number, _Number]]])
"""World, end, duration [s], length of the optimal path [m] and remaining distance [m] of each drive, by method."""


class BarnTable:
    """Benchmark drives by method."""

    def __init__(self, file: Path | None, seed: int) -> None:
        """Read the drives that a file already has.

        Raises:
            TrialError: The file has drives with another seed, or belongs to another benchmark.
        """
        self._file, self._seed = file, seed
        self._drives: dict[str, dict[int, BarnDrive]] = {}
        self._take()

    def _take(self) -> None:
        """Read new drives from the file, which another command may also extend."""
        file, seed = self._file, self._seed
        if file is None or not file.exists():
            return
        there = read_experiment(file)
        if there is None or there.experiment != "barn" or not isinstance(there.figures, dict):
            raise TrialError(f"{file}: has no drives of this benchmark: give another file")
        if there.seeds != [seed]:
            raise TrialError(f"{file}: its drives have seed {there.seeds}, not {seed}: give another file")
        try:
            told = _DRIVES.validate_python(there.figures.get("drives"))
        except ValidationError:
            raise TrialError(f"{file}: its drives are damaged: give another file") from None
        for method, drives in told.items():
            here = self._drives.setdefault(method, {})
            for each in drives:
                here.setdefault(each[0], BarnDrive(*each))

    def has(self, method: str, world: int) -> bool:
        """Return whether the table already has a drive."""
        return world in self._drives.get(method, {})

    def add(self, method: str, drive: BarnDrive) -> None:
        """Add a drive and write the file, so that an interrupted command loses nothing."""
        self._drives.setdefault(method, {})[drive.world] = drive
        if self._file is None:
            return
        with results_lock(self._file):
            self._take()
            drives = {
                name: [[each.world, each.end, each.seconds, each.length, each.distance] for each in self._sorted(name)]
                for name in self._drives
            }
            write_results(self._file, "barn", [self._seed], self.rows(), {"drives": drives})

    def rows(self) -> list[Result]:
        """Return the result rows, with separate rows for BARN and DynaBARN."""
        out = []
        for method in self._drives:
            drives = self._sorted(method)
            for name, moving in (("BARN", False), ("DynaBARN", True)):
                if part := [drive for drive in drives if (drive.world >= STATIC) == moving]:
                    out += _rows(f"{method}, {name}", part)
        return out

    def text(self) -> str:
        """Return the figures as text, one line per method."""
        figures = {(row.method, row.metric): row.values[0] for row in self.rows()}
        return "\n".join(
            f"{method:<40} score {figures[method, 'score']:.3f}, success {figures[method, 'success']:4.0%}, "
            f"collisions {figures[method, 'collisions']:4.0%}, {figures[method, 'worlds']:.0f} worlds"
            for method in dict.fromkeys(method for method, _ in figures)
        )

    def _sorted(self, method: str) -> list[BarnDrive]:
        return [drive for _, drive in sorted(self._drives[method].items())]


def _rows(method: str, drives: Sequence[BarnDrive]) -> list[Result]:
    """Return a method's result rows, with means over the worlds."""
    figures: list[tuple[str, str, Sequence[float]]] = [
        ("score", "1", [drive.score() for drive in drives]),
        ("score of the ROS 2 report", "1", [drive.score(LOW_ROS2) for drive in drives]),
        ("success", "1", [drive.end == "goal" for drive in drives]),
        ("collisions", "1", [drive.end in ("collision", "hit") for drive in drives]),
        ("hit while standing", "1", [drive.end == "hit" for drive in drives]),
        ("time", "s", [drive.seconds for drive in drives if drive.end == "goal"]),
    ]
    rows = [Result(method, metric, unit, [float(np.mean(values))]) for metric, unit, values in figures if values]
    return [*rows, Result(method, "worlds", "1", [float(len(drives))])]
