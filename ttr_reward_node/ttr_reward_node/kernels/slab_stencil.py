"""Compiled stencils of a whole slab under one pair, for short rows.

The nodes of a slab are contiguous in memory, and a displacement by whole cells along the inner axes is a single offset.
So a slab of 20 x 20 nodes is one row of 400; nodes whose step would cross an edge of the slab are masked. The 2^n
corners of a cell are summed axis by axis: first the outer axes, then two neighbours along each inner axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.row_interpolation import Part
from ttr_reward_node.kernels.stencil import MOST_AXES, MOST_CORNERS, PER_CELL, Floats, Grid, Integers

_OPTIONS = {"error_model": "numpy"}
_BITS = 11  # PER_CELL = 2 ** _BITS, so a shift and a mask split a displacement
_ROUNDED = 3  # rounding error of a step truncated at the edge [1 / PER_CELL cells]
_CELL = np.float32(1.0 / PER_CELL)
_ALL = np.float32(0.99)  # weight of the start node above which a step leads nowhere
LEAST_PART = 3
"""Distance to a plane of the grid [1 / PER_CELL cells] below which no curvature is added."""

SLAB_STENCIL = np.dtype(
    [
        ("size", np.int64),
        ("corner", np.int64, MOST_CORNERS),
        ("weight", np.float32, MOST_CORNERS),
        ("lower", np.int64, MOST_AXES),
        ("part", np.int64, MOST_AXES),
        ("begin", np.int64, MOST_AXES),
        ("end", np.int64, MOST_AXES),
        ("own", np.float32),
        ("discount", np.float32),
        ("long", np.int64),
    ],
    align=True,
)
"""Stencil of a slab under one pair.

Fields:
    size: Number of slabs in the stencil; 0 if the step leaves the grid.
    corner, weight: Offset and weight of each of these slabs.
    lower: Lower node along each axis: its index on an outer axis, cells from the start on an inner one.
    part: Distance from the lower node along each axis [1 / PER_CELL cells].
    begin, end: Range of the nodes along each inner axis whose steps stay on the grid.
    own: Weight of the start node among the corners.
    discount: Discount exp(-lambda h) of the step, as in `kernels.sweep`.
    long: 1 for a long step, which counts only if all corners are reachable without a jump between them, else 0.
"""

SlabStencil = Any
"""Record of the dtype `SLAB_STENCIL`."""


@njit(**_OPTIONS)
def place_slab(
    grid: Grid,
    index: Integers,
    own: Part,
    move: NDArray[np.int16],
    ranges: NDArray[np.int8],
    discount: np.float32,
    stencil: SlabStencil,
) -> None:
    """Fill in the stencil of the slab at `index` (n,) for one pair's displacement `move` (n,) [1 / PER_CELL cells].

    Args:
        grid: Axes; no inner axis is periodic.
        index: Index of the slab along the outer axes (n,).
        own: Part of the grid being swept.
        move: Displacement (n,) [1 / PER_CELL cells].
        ranges: Lowest and highest cell of the step's path along each inner axis (inner, 2).
        discount: Discount exp(-lambda h) of the step.
        stencil: Record to fill in.
    """
    size, at_home = 1, np.float32(1.0)
    stencil.size, stencil.corner[0], stencil.weight[0] = 0, 0, np.float32(1.0)
    for k in range(grid.n):
        cells = np.int64(move[k])
        lower, part = cells >> _BITS, cells & (PER_CELL - 1)
        upper_weight = np.float32(part) * _CELL
        home = np.float32(1.0) - upper_weight if lower == 0 else (upper_weight if lower == -1 else np.float32(0.0))
        count = grid.counts[k]
        if k >= grid.n_outer:
            low, high = np.int64(ranges[k - grid.n_outer, 0]), np.int64(ranges[k - grid.n_outer, 1])
            stencil.begin[k] = max(-low, -lower, 0)
            stencil.end[k] = count - max(high, lower + (1 if part > 0 else 0), 0)
            if stencil.begin[k] >= stencil.end[k]:
                return
        else:
            lower, ahead = lower + index[k], np.int64(1)
            if grid.periodic[k]:
                lower %= count
                if lower == count - 1:
                    ahead = -lower
            else:
                if lower == -1 and part >= PER_CELL - _ROUNDED:
                    lower, part, home = np.int64(0), np.int64(0), np.float32(1.0 if index[k] == 0 else 0.0)
                if lower == count - 1 and part <= _ROUNDED:
                    part = np.int64(0)
                if lower < 0 or lower + (part > 0) >= count:
                    return
                upper_weight = np.float32(part) * _CELL
            for c in range(size):
                stencil.corner[c] += lower * grid.strides[k]
            if part > 0:
                for c in range(size):
                    stencil.corner[size + c] = stencil.corner[c] + ahead * grid.strides[k]
                    stencil.weight[size + c] = stencil.weight[c] * upper_weight
                    stencil.weight[c] *= np.float32(1.0) - upper_weight
                size *= 2
        at_home *= home
        stencil.lower[k], stencil.part[k] = lower, part
    if at_home > _ALL:
        return
    for c in range(size):
        if not own.begin <= stencil.corner[c] < own.end:
            stencil.corner[c] += own.copy
    stencil.own = at_home
    stencil.discount = discount / (np.float32(1.0) - discount * at_home)
    stencil.size = size


@njit(**_OPTIONS)
def fill_mask(grid: Grid, begin: Integers, end: Integers, mask: Floats) -> None:
    """Fill `mask` (nodes of a slab,) with 1 for nodes within the range of every inner axis, else 0."""
    last = grid.counts[grid.n - 1]
    for row in range(len(mask) // last):
        rest, inside = row, True
        for k in range(grid.n - 2, grid.n_outer - 1, -1):
            i = rest % grid.counts[k]
            rest //= grid.counts[k]
            inside &= begin[k] <= i < end[k]
        line = mask[row * last : (row + 1) * last]
        low, high = begin[grid.n - 1], end[grid.n - 1]
        for j in range(last):
            line[j] = np.float32(1.0) if inside and low <= j < high else np.float32(0.0)
