"""The time to reach a goal from each point of a map, with gradient and descent path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]
Times = NDArray[np.float32]

_STEP = 0.5
"""Step length of a path [cells]."""


@njit(inline="always")
def value_and_slopes(times: Any, row: float, column: float) -> tuple[float, float, float]:
    """Return the time at a point given in cells, and its slopes along rows and columns [s/cell].

    The four surrounding cells are interpolated, ignoring cells without a time; inf if none has a time.
    """
    height, width = times.shape
    low, left = math.floor(row), math.floor(column)
    total = weight = by_row = by_column = row_weight = column_weight = 0.0
    for i in range(2):
        for j in range(2):
            r, c = int(low) + i, int(left) + j
            if r < 0 or c < 0 or r >= height or c >= width:
                continue
            time = times[r, c]
            if time == np.inf:
                continue
            u = row - low if i else 1.0 - (row - low)
            v = column - left if j else 1.0 - (column - left)
            total += u * v * time
            weight += u * v
            sign_row, sign_column = (1.0 if i else -1.0), (1.0 if j else -1.0)
            by_row += sign_row * v * time
            row_weight += sign_row * v
            by_column += sign_column * u * time
            column_weight += sign_column * u
    if weight < 1e-9:
        return np.inf, 0.0, 0.0
    value = total / weight
    # Slopes of sum(w t) / sum(w), which are those of the plane if all four cells count.
    return value, (by_row - value * row_weight) / weight, (by_column - value * column_weight) / weight


@cached_njit
def _values(times: Times, places: Array, out: Array) -> None:
    """Fill in time and slopes (n, 3) at points (n, 2) in cells."""
    for i in range(len(places)):
        out[i, 0], out[i, 1], out[i, 2] = value_and_slopes(times, places[i, 0], places[i, 1])


@njit(inline="always")
def _lowest_neighbour(times: Any, row: float, column: float) -> tuple[float, float]:
    height, width = times.shape
    r, c = round(row), round(column)
    best, at_row, at_column = np.inf, row, column
    for i in range(max(r - 1, 0), min(r + 2, height)):
        for j in range(max(c - 1, 0), min(c + 2, width)):
            if times[i, j] < best:
                best, at_row, at_column = times[i, j], float(i), float(j)
    return at_row, at_column


@cached_njit
def _descend(times: Times, row: float, column: float, out: Array) -> int:
    """Fill in the points (n, 2) in cells of the steepest descent and return their number."""
    value, _, _ = value_and_slopes(times, row, column)
    count = 0
    while count < len(out):
        out[count, 0], out[count, 1] = row, column
        count += 1
        if not value > 0.0:
            break
        _, by_row, by_column = value_and_slopes(times, row, column)
        steep = math.hypot(by_row, by_column)
        next_row, next_column = row, column
        if steep > 0.0:
            next_row, next_column = row - _STEP * by_row / steep, column - _STEP * by_column / steep
        after, _, _ = value_and_slopes(times, next_row, next_column)
        if not after < value - 1e-9:  # a kink: continue at the lowest surrounding cell
            next_row, next_column = _lowest_neighbour(times, row, column)
            after, _, _ = value_and_slopes(times, next_row, next_column)
            if not after < value - 1e-9:
                break
        row, column, value = next_row, next_column, after
    return count


@dataclass(frozen=True, eq=False)
class MapValue:
    """The time to reach a goal on a map, usable like the suite's other value functions.

    Attributes:
        times: Times at the cell centres (rows, columns) [s]; inf where the goal is unreachable.
        map: Map with the same geometry.
        goal: Position of the goal in the map frame (2,) [m].
        radius: Distance from the goal at which the time is zero [m].
        seconds: Duration of the solve [s].
        along: Whether the times are those along a given path.
    """

    times: Times
    map: OccupancyMap
    goal: tuple[float, float]
    radius: float
    seconds: float
    along: bool = False

    state_names = ("x", "y")

    def value(self, states: ArrayLike) -> Array:
        """Return the times (...) at points (..., 2) [m]: NaN off the map, inf where the goal is unreachable."""
        return self.value_and_gradient(states)[0]

    def value_and_gradient(self, states: ArrayLike) -> tuple[Array, Array]:
        """Return times (...) [s] and gradients (..., 2) [s/m] at points (..., 2) [m]."""
        points = np.asarray(states, np.float64)
        places = self.map.to_grid(points).reshape(-1, 2)
        finite = np.isfinite(places).all(axis=1)
        height, width = self.times.shape
        inside = finite & (places > -0.5).all(axis=1) & (places < (height - 0.5, width - 0.5)).all(axis=1)
        out = np.full((len(places), 3), np.nan)
        found = np.empty((int(inside.sum()), 3))
        _values(self.times, places[inside], found)
        out[inside] = found
        c, s = math.cos(self.map.origin[2]), math.sin(self.map.origin[2])
        up, right = out[:, 1] / self.map.resolution, out[:, 2] / self.map.resolution
        gradient = np.stack((c * right - s * up, s * right + c * up), axis=-1)
        return out[:, 0].reshape(points.shape[:-1]), gradient.reshape(points.shape)

    def path(self, start: ArrayLike, longest: int = 20_000) -> Array:
        """Return the points (n, 2) of the steepest descent from a start (2,) [m]; a single point if there is no path.

        Args:
            start: First point of the path [m].
            longest: Maximum number of points.
        """
        row, column = self.map.to_grid(start)
        places = np.empty((longest, 2))
        count = _descend(self.times, float(row), float(column), places)
        return self.map.cell_to_world(places[:count, 0], places[:count, 1])


def path_length(path: Array) -> float:
    """Return the length of a path (n, 2) [m]."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
