"""The nodes that a step ends between, their weights, and the curvature that linear interpolation misses; compiled.

All nodes of a slab (see `steps`) take the same steps, so a step's end lies the same way between the nodes for all of
them: corners and weights are found once a slab, and the sweep only adds up products.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

_OPTIONS = {"error_model": "numpy"}


class Grid(NamedTuple):
    """Axes in the layout's order, for compiled code; strides are in nodes. The last axis is an inner one."""

    counts: NDArray[np.int64]
    periodic: NDArray[np.bool_]
    strides: NDArray[np.int64]
    n_outer: int


class Corners(NamedTuple):
    """The 2^n or fewer nodes around the end of each pair's step from a slab: where they are and what they weigh.

    `outer` (pairs, c) is the offset of the corner's slab, `shift` (pairs, c, inner axes) its cells along each inner
    axis, `weight` (pairs, c), `number` (pairs,); 0 where the step leaves the grid. Corners come in an order in which
    the second half repeats the first, a cell further along the last axis, wherever that axis is interpolated.
    """

    number: NDArray[np.int64]
    outer: NDArray[np.int64]
    shift: NDArray[np.int64]
    weight: NDArray[np.float32]


class Curves(NamedTuple):
    """Four nodes in a line around the end of the step, along each axis on which it ends between nodes.

    `outer` (pairs, 4 q), `shift` (pairs, 4 q, inner axes), `weight` (pairs, q), `number` (pairs,).
    """

    number: NDArray[np.int64]
    outer: NDArray[np.int64]
    shift: NDArray[np.int64]
    weight: NDArray[np.float32]


@njit(**_OPTIONS)
def make_corners(pairs: int, n: int, n_outer: int) -> Corners:
    """Room for the corners of one slab."""
    most = 1 << n
    return Corners(
        np.zeros(pairs, np.int64),
        np.zeros((pairs, most), np.int64),
        np.zeros((pairs, most, n - n_outer), np.int64),
        np.zeros((pairs, most), np.float32),
    )


@njit(**_OPTIONS)
def make_curves(pairs: int, n: int, n_outer: int) -> Curves:
    """Room for the curves of one slab."""
    return Curves(
        np.zeros(pairs, np.int64),
        np.zeros((pairs, 4 * n), np.int64),
        np.zeros((pairs, 4 * n, n - n_outer), np.int64),
        np.zeros((pairs, n), np.float32),
    )


@njit(**_OPTIONS)
def place_corners(grid: Grid, index: NDArray[np.int64], move: NDArray[np.float32], p: int, corners: Corners) -> None:
    """Fill in pair p's corners for the slab at `index` (n,) and its move (n,) [cells]."""
    number, outer, shift, weight = corners
    n = grid.counts.size
    size = 1
    number[p], outer[p, 0], weight[p, 0] = 0, 0, 1.0
    for k in range(n):
        position = np.float64(move[k])
        if k < grid.n_outer:
            position += index[k]
        lower = int(np.floor(position))
        upper_weight = float(position - lower)
        upper = lower + 1
        if k < grid.n_outer:
            if grid.periodic[k]:
                lower, upper = lower % grid.counts[k], upper % grid.counts[k]
            else:
                # A step that was cut short at the edge ends there only to rounding.
                if lower == -1 and upper_weight > 0.999:
                    lower, upper_weight = 0, 0.0
                if lower == grid.counts[k] - 1 and upper_weight < 0.001:
                    upper_weight = 0.0
                if lower < 0 or lower + (upper_weight > 0.0) >= grid.counts[k]:
                    return
        between = upper_weight > 0.0
        for c in range(size):
            if between:
                weight[p, size + c] = weight[p, c] * upper_weight
                weight[p, c] *= 1.0 - upper_weight
                outer[p, size + c] = outer[p, c]
                for j in range(grid.counts.size - grid.n_outer):
                    shift[p, size + c, j] = shift[p, c, j]
            if k < grid.n_outer:
                if between:
                    outer[p, size + c] += upper * grid.strides[k]
                outer[p, c] += lower * grid.strides[k]
            else:
                if between:
                    shift[p, size + c, k - grid.n_outer] = upper
                shift[p, c, k - grid.n_outer] = lower
        if between:
            size *= 2
    number[p] = size


@njit(**_OPTIONS)
def place_curves(grid: Grid, index: NDArray[np.int64], move: NDArray[np.float32], p: int, curves: Curves) -> None:
    """Fill in pair p's curves, as `place_corners`; an axis on which four nodes do not fit has none."""
    number, outer, shift, weight = curves
    n = grid.counts.size
    number[p] = 0
    for k in range(n):
        position = np.float64(move[k])
        if k < grid.n_outer:
            position += index[k]
        lower = int(np.floor(position))
        part = position - lower
        outside = k < grid.n_outer and not grid.periodic[k] and (lower < 1 or lower + 2 >= grid.counts[k])
        if part < 1e-3 or part > 1.0 - 1e-3 or outside:
            continue
        q = number[p]
        number[p] += 1
        # What linear interpolation between the middle two leaves out is the second difference times this.
        weight[p, q] = -0.5 * part * (1.0 - part)
        for i in range(4):
            outer[p, 4 * q + i] = 0
            for m in range(n):
                if m < grid.n_outer:
                    at = lower - 1 + i if m == k else int(np.round(index[m] + move[m]))
                    at = at % grid.counts[m] if grid.periodic[m] else min(max(at, 0), grid.counts[m] - 1)
                    outer[p, 4 * q + i] += at * grid.strides[m]
                else:
                    shift[p, 4 * q + i, m - grid.n_outer] = lower - 1 + i if m == k else int(np.round(move[m]))
