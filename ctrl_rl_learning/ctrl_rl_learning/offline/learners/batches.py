"""Scales of recorded observations, and random batches of rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Vectors = NDArray[np.float32]
_LEAST_UNIT = 1e-3


def scales_of(observations: Vectors) -> tuple[Vectors, Vectors]:
    """Return middle and unit (n,), (n,) of observations (N, n): mean and spread, so that inputs are of order 1."""
    spread = observations.std(axis=0)
    return observations.mean(axis=0), np.where(spread > _LEAST_UNIT, spread, 1.0).astype(np.float32)


def batches(
    tensors: tuple[Tensor, ...], size: int, count: int, random: np.random.Generator
) -> Iterator[tuple[Tensor, ...]]:
    """Yield `count` random batches of rows."""
    rows = len(tensors[0])
    for _ in range(count):
        chosen = torch.from_numpy(random.integers(rows, size=size))
        yield tuple(tensor[chosen] for tensor in tensors)
