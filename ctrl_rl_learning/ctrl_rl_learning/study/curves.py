"""Learning curves in a run's folder, for every learner: curve.csv and TensorBoard events.

    with Curves(folder, known) as curves:       # known: points of a resumed run
        curves.add({"samples": 2048, "evaluation": 0.4, "losses": {"loss": 0.1, "entropy": 1.2}})

Names are the same in both files and for all learners: `success`, `return`, `loss`, `entropy`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from ctrl_rl_core import atomic_write

FILE = "curve.csv"
_STEPS = ("samples", "actions", "updates")
"""Candidate names for the x axis of a curve: the first one in a point is used, else the point's index."""
_NAMES = {"evaluation": "success", "best": "return"}
_PLAIN = frozenset({"losses", "learning", "update"})
"""Groups whose figures keep their names without a prefix."""


def scalars(point: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers in a point by name, prefixed by the name of their group; omit lists."""
    out: dict[str, float] = {}
    for name, value in _flat(point):
        out.setdefault(name, value)
    return out


def _flat(point: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in point.items():
        if isinstance(value, Mapping):
            yield from ((each if name in _PLAIN else f"{name}/{each}", number) for each, number in _flat(value))
        elif isinstance(value, int | float):
            yield _NAMES.get(name, name), float(value)


class Curves:
    """Curves of one run, rewritten after each point.

    Args:
        folder: Folder of the run.
        known: Points of earlier calls.
    """

    def __init__(self, folder: Path, known: Sequence[Mapping[str, Any]] = ()) -> None:
        from torch.utils.tensorboard import SummaryWriter  # takes a second to import, so only where something is learnt

        self._file, self._rows = folder / FILE, [scalars(point) for point in known]
        # Hide the points that a killed call wrote after its last checkpoint.
        purge = self._step(self._rows[-1]) + 1 if self._rows else None
        self._events = SummaryWriter(str(folder), purge_step=purge)

    def __enter__(self) -> Self:
        """Return self."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the event file."""
        self._events.close()

    def add(self, point: Mapping[str, Any]) -> None:
        """Add a point and write it."""
        row = scalars(point)
        self._rows.append(row)
        step = self._step(row)
        for name, value in row.items():
            self._events.add_scalar(name, value, step)
        self._events.flush()
        names = list(dict.fromkeys(name for each in self._rows for name in each))
        text = io.StringIO()
        table = csv.DictWriter(text, names, lineterminator="\n")
        table.writeheader()
        table.writerows(self._rows)
        atomic_write(self._file, text.getvalue())

    def _step(self, row: Mapping[str, float]) -> int:
        return int(next((row[name] for name in _STEPS if name in row), len(self._rows)))
