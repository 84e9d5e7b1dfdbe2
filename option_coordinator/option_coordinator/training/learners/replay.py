"""Option steps that are learnt from again and again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from ctrl_rl_training.io.learner_state import Arrays
from numpy.typing import NDArray

from option_coordinator.data.trajectory import OptionTrajectory


class Replay:
    """Keeps the latest option steps.

    Args:
        capacity: how many.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._columns: Arrays = {}
        self._seen = 0

    def __len__(self) -> int:
        return min(self._seen, self._capacity)

    def add(self, trajectory: OptionTrajectory) -> None:
        """Keep option steps; the oldest go where there is no room."""
        rows = (self._seen + np.arange(len(trajectory))) % self._capacity
        for field in fields(trajectory):
            part = getattr(trajectory, field.name)
            column = self._columns.setdefault(field.name, np.empty((self._capacity, *part.shape[1:]), part.dtype))
            column[rows] = part
        self._seen += len(trajectory)

    def draw(self, count: int, generator: np.random.Generator) -> OptionTrajectory:
        """Return option steps, each as likely as any other, each by itself."""
        rows = generator.integers(len(self), size=count)
        parts = {name: column[rows] for name, column in self._columns.items()}
        return OptionTrajectory(**{**parts, "last": np.ones(count, dtype=bool)})

    def arrays(self) -> Arrays:
        """Return everything, for a checkpoint."""
        return {"seen": np.array([self._seen])} | {name: column[: len(self)] for name, column in self._columns.items()}

    def recall(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take up what `arrays` returned."""
        parts = dict(arrays)
        self._seen = int(parts.pop("seen")[0])
        self._columns = {name: np.empty((self._capacity, *p.shape[1:]), p.dtype) for name, p in parts.items()}
        for name, part in parts.items():
            self._columns[name][: len(part)] = part
