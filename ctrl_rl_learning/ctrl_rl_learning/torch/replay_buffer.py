"""Replay buffer of samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]


class ReplayBuffer:
    """Ring buffer of rows with named columns; new rows overwrite the oldest once it is full.

    Args:
        capacity: Maximum number of rows.
        columns: Columns of `capacity` rows; created from the first rows by default.
    """

    def __init__(self, capacity: int, columns: Arrays | None = None) -> None:
        self.capacity = capacity
        self.columns = columns or {}
        self.seen = 0

    def __len__(self) -> int:
        return min(self.seen, self.capacity)

    def add(self, rows: Mapping[str, NDArray[Any]]) -> None:
        """Add rows (N, ...), by column."""
        count = len(next(iter(rows.values())))
        places = (self.seen + np.arange(count)) % self.capacity
        for name, part in rows.items():
            if name not in self.columns:
                self.columns[name] = np.empty((self.capacity, *part.shape[1:]), part.dtype)
            self.columns[name][places] = part
        self.seen += count

    def draw(self, count: int, generator: np.random.Generator) -> Arrays:
        """Return rows (count, ...) by column, drawn uniformly with replacement."""
        places = generator.integers(len(self), size=count)
        return {name: column[places] for name, column in self.columns.items()}

    def in_order(self) -> Arrays:
        """Return all rows by column, oldest first."""
        order = np.arange(self.seen - len(self), self.seen) % self.capacity
        return {name: column[order] for name, column in self.columns.items()}

    def arrays(self) -> Arrays:
        """Return the buffer's content, for a checkpoint."""
        return {"seen": np.array([self.seen])} | {name: column[: len(self)] for name, column in self.columns.items()}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the content that `arrays` returned."""
        self.seen = int(arrays["seen"][0])
        for name, part in arrays.items():
            if name != "seen":
                self.columns[name] = np.empty((self.capacity, *part.shape[1:]), part.dtype)
                self.columns[name][: len(part)] = part
