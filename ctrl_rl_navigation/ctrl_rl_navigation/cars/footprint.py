"""Whether a rectangle at a pose touches an obstacle, by the distances of places to the nearest one.

A disc around a part of the rectangle that is free of obstacles frees the part, and an obstacle within the part's own
disc refuses it; parts about which neither says anything are quartered. All lengths are in cells.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

_DEPTH = 4
"""Number of times a part is quartered."""
_LEAST = 0.35
"""Half the side of a part below which it is not quartered [cells]."""


class Footprint(NamedTuple):
    """A rectangle, in cells.

    Attributes:
        centre: Position of its middle ahead of the rear axle.
        half_length: Half its length.
        half_width: Half its width.
    """

    centre: float
    half_length: float
    half_width: float


@njit(inline="always")
def distance(field: Any, row: float, column: float) -> float:
    """Interpolate the distance to the nearest obstacle [cells]; 0 outside the field."""
    height, width = field.shape
    if not (0.0 <= row < height - 1.0 and 0.0 <= column < width - 1.0):
        return 0.0
    low, left = int(row), int(column)
    u, v = row - low, column - left
    below = field[low, left] + v * (field[low, left + 1] - field[low, left])
    above = field[low + 1, left] + v * (field[low + 1, left + 1] - field[low + 1, left])
    return float(below + u * (above - below))


@njit
def _part_fits(field: Any, row: float, column: float, c: float, s: float, half_x: float, half_y: float) -> bool:
    """Return whether a part, given by its centre and half its sides, touches nothing.

    Quarters of quarters are numbered in order, so that a block of them is a range of numbers: what is free is skipped.
    This is a recursion without calls, since Numba cannot keep compiled recursions.
    """
    number = 0
    while number < 1 << (2 * _DEPTH):
        level = _DEPTH  # of the largest block that begins here
        while level > 0 and number & ((1 << (2 * level)) - 1):
            level -= 1
        while True:
            along = aside = 0.0
            share = 1.0
            for bit in range(_DEPTH - 1, level - 1, -1):
                share *= 0.5
                quarter = number >> (2 * bit)
                along += share * half_x if quarter & 1 else -share * half_x
                aside += share * half_y if quarter & 2 else -share * half_y
            x, y = share * half_x, share * half_y
            away = distance(field, row + s * along + c * aside, column + c * along - s * aside)
            across = math.hypot(x, y)
            if away >= across:
                break
            if away < min(x, y):
                return False
            if level == 0 or max(x, y) < _LEAST:
                if away < 0.7 * across:
                    return False
                break
            level -= 1
        number += 1 << (2 * level)
    return True


@njit(inline="always")
def fits(field: Any, row: float, column: float, theta: float, footprint: Any) -> bool:
    """Return whether the rectangle fits at a pose of the rear axle: row, column [cells], heading [rad]."""
    c, s = math.cos(theta), math.sin(theta)
    centre, half_length, half_width = footprint
    middle_row, middle_column = row + s * centre, column + c * centre
    if distance(field, middle_row, middle_column) >= math.hypot(half_length, half_width):
        return True
    parts = max(1, int(half_length / half_width + 0.5))
    half = (half_length / parts, half_width)
    for part in range(parts):
        along = (2.0 * part + 1.0 - parts) * half[0]
        if not _part_fits(field, middle_row + s * along, middle_column + c * along, c, s, half[0], half[1]):
            return False
    return True


@cached_njit
def fit_all(field: Any, places: Any, footprint: Any) -> NDArray[np.bool_]:
    """Return whether the rectangle fits at places (n, 3): row, column [cells], heading [rad]."""
    out = np.empty(len(places), np.bool_)
    for i in range(len(places)):
        out[i] = fits(field, places[i, 0], places[i, 1], places[i, 2], footprint)
    return out


def footprint_of(length: float, width: float, centre: float, margin: float, resolution: float) -> Footprint:
    """Return a rectangle with a margin around it, all in metres, in cells of a resolution [m]."""
    return Footprint(centre / resolution, (0.5 * length + margin) / resolution, (0.5 * width + margin) / resolution)


def distances(clearance: NDArray[np.float32], resolution: float) -> NDArray[np.float32]:
    """Convert a map's clearance (rows, columns) [m] to cells, limited to a finite number."""
    return np.minimum(clearance / np.float32(resolution), np.float32(1e6))
