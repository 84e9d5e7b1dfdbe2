"""Covers a rectangular robot by a row of discs, for the set only; certificates use the rectangle itself."""

from __future__ import annotations

import math

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.robot_model import RobotModel

Array = NDArray[np.float64]
Field = NDArray[np.float32]

HEADINGS = 36
"""Number of headings of a set."""


@cached_njit
def margins_of_row(margins: Field, offsets: Array, cell: float) -> Field:
    """Return the minimum of margins (rows, columns) over a row of discs (HEADINGS, rows, columns).

    Args:
        margins: Margins of one disc.
        offsets: Positions of the discs ahead of the centre (n,) [m].
        cell: Node spacing [m].
    """
    rows, columns = margins.shape
    out = np.empty((HEADINGS, rows, columns), np.float32)
    for heading in range(HEADINGS):
        theta = 2.0 * math.pi * heading / HEADINGS
        for row in range(rows):
            for column in range(columns):
                least = np.float32(np.inf)
                for k in range(len(offsets)):
                    x = min(max(column + offsets[k] * math.cos(theta) / cell, 0.0), columns - 1.0)
                    y = min(max(row + offsets[k] * math.sin(theta) / cell, 0.0), rows - 1.0)
                    j, i = min(int(x), columns - 2), min(int(y), rows - 2)
                    u, w = x - j, y - i
                    lower = (1.0 - u) * margins[i, j] + u * margins[i, j + 1]
                    upper = (1.0 - u) * margins[i + 1, j] + u * margins[i + 1, j + 1]
                    least = min(least, np.float32((1.0 - w) * lower + w * upper))
                out[heading, row, column] = least
    return out


def discs_of(model: RobotModel) -> tuple[Array, float]:
    """Return positions ahead of the centre (n,) [m] and the radius [m] of discs that cover the robot."""
    half_length, half_width = model.core
    if half_length == 0.0:
        return np.zeros(1), model.radius
    count = math.ceil(2.0 * half_length / half_width)
    half = half_length / count
    return np.linspace(half - half_length, half_length - half, count), math.hypot(half, half_width)
