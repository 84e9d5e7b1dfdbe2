"""Running statistics of a column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Statistics:
    """Minimum, maximum, mean and standard deviation of each component, over finite values only.

    The components of an image are its colour channels.
    """

    def __init__(self) -> None:
        self._count: NDArray[np.int64] | None = None

    def add(self, values: NDArray[np.generic]) -> None:
        """Add values (n, ...)."""
        numbers = np.asarray(values, dtype=np.float64)
        numbers = numbers.reshape(-1, numbers.shape[-1] if numbers.ndim > 1 else 1)
        known = np.isfinite(numbers)
        if self._count is None:
            width = numbers.shape[1]
            self._count = np.zeros(width, dtype=np.int64)
            self._least, self._most = np.full(width, np.inf), np.full(width, -np.inf)
            self._mean, self._squares = np.zeros(width), np.zeros(width)
        count = known.sum(axis=0)
        mean = np.where(known, numbers, 0.0).sum(axis=0) / np.maximum(count, 1)
        squares = (np.where(known, numbers - mean, 0.0) ** 2).sum(axis=0)
        total = np.maximum(self._count + count, 1)
        # Chan, Golub, LeVeque 1979: mean and sum of squares of two sets from those of each set.
        self._squares += squares + (mean - self._mean) ** 2 * self._count * count / total
        self._mean += (mean - self._mean) * count / total
        self._count += count
        self._least = np.minimum(self._least, np.where(known, numbers, np.inf).min(axis=0))
        self._most = np.maximum(self._most, np.where(known, numbers, -np.inf).max(axis=0))

    def summary(self) -> dict[str, list[float]]:
        """Return the statistics for JSON; 0 if no value was finite."""
        if self._count is None:
            return {}
        none = self._count == 0
        return {
            "min": np.where(none, 0.0, self._least).tolist(),
            "max": np.where(none, 0.0, self._most).tolist(),
            "mean": self._mean.tolist(),
            "std": np.sqrt(self._squares / np.maximum(self._count, 1)).tolist(),
            "count": [int(self._count.max())],
        }
