"""An estimate over episodes with its interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_RESAMPLED = 1000


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % interval over resampled episodes and fits."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:9.3f}  ({self.low:.3f} to {self.high:.3f})"


def estimate(numbers: Array, random: np.random.Generator) -> Estimate:
    """Return mean and interval of numbers (fits, episodes), by resampling episodes and drawing a fit."""
    fits, count = numbers.shape
    drawn = random.integers(count, size=(_RESAMPLED, count))
    means = numbers[random.integers(fits, size=_RESAMPLED)[:, None], drawn].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return Estimate(float(numbers.mean()), float(low), float(high))
