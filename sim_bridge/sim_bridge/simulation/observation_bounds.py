"""Names and bounds of a task's observations."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.policies import state_ranges
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask

Vector = NDArray[np.float32]


def observation_bounds(task: NavigationTask) -> tuple[tuple[str, ...], Vector, Vector]:
    """Return names, minimum and maximum of an observation in SI units, (n,) each."""
    ranges = state_ranges(task)
    beams, reach = task.lidar.beams, task.lidar.range
    names = (*ranges, *(f"beam_{index}" for index in range(beams)))
    low = np.array([*(low for low, _ in ranges.values()), *[reach.low] * beams], dtype=np.float32)
    high = np.array([*(high for _, high in ranges.values()), *[reach.high] * beams], dtype=np.float32)
    return names, low, high
