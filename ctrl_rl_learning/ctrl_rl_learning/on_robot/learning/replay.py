"""Every step that the robot ever made, for learning from again and again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Vectors = NDArray[np.float32]


class Steps(NamedTuple):
    """Steps, one a row.

    Attributes:
        seen: Observations before (N, n).
        actions: Actions as they were driven, the operator's included (N, 2).
        rewards: Rewards of the steps (N,).
        following: Observations after (N, n).
        discounts: Discounts of what followed (N,): less after a longer step, 0 where the episode ended.
        operator: Whether the operator drove a part of the step (N,), as 0 or 1.
    """

    seen: Any
    actions: Any
    rewards: Any
    following: Any
    discounts: Any
    operator: Any


class Replay:
    """A growing table of steps, at most `capacity` of them: a robot's hours are short."""

    def __init__(self, capacity: int, inputs: int) -> None:
        widths = Steps((inputs,), (2,), (), (inputs,), (), ())
        self._table = Steps(*(np.zeros((capacity, *width), np.float32) for width in widths))
        self._capacity, self._count = capacity, 0

    def __len__(self) -> int:
        return min(self._count, self._capacity)

    def add(self, *row: Any) -> None:
        """Add a step, in the order of `Steps`; the oldest makes room."""
        place = self._count % self._capacity
        for column, value in zip(self._table, row, strict=True):
            column[place] = value
        self._count += 1

    def batch(self, size: int, random: np.random.Generator) -> Steps:
        """Return random steps as tensors."""
        rows = random.integers(len(self), size=size)
        return Steps(*(torch.from_numpy(column[rows]) for column in self._table))

    def seen(self) -> Tensor:
        """Return all observations before a step (N, n)."""
        return torch.from_numpy(self._table.seen[: len(self)])

    def arrays(self) -> dict[str, Vectors]:
        """Return all steps, oldest first, for a checkpoint."""
        order = np.arange(self._count - len(self), self._count) % self._capacity
        return {f"replay.{name}": column[order] for name, column in self._table._asdict().items()}

    def restore(self, arrays: Mapping[str, Vectors]) -> None:
        """Take the steps of a checkpoint.

        Raises:
            KeyError, ValueError: They are of another replay.
        """
        for name, column in self._table._asdict().items():
            kept = arrays[f"replay.{name}"][-self._capacity :]
            column[: len(kept)] = kept
            self._count = len(kept)
