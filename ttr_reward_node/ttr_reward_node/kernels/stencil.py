"""Compiled stencils: nodes around the end of each step, their weights, and the curvature for linear interpolation.

All nodes of a slab have the same outer state of `solvers.steps`, and take the same steps. So a step ends at the same
position between nodes for all of them: offsets and weights are computed once per slab, and the sweep only sums
products.

The tables are NumPy records because Numba counts references for every array taken out of a tuple, which costs more than
the arithmetic; fields of a record are plain memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

_OPTIONS = {"error_model": "numpy"}
MOST_CORNERS, MOST_AXES = 64, 7
"""Maximum number of corners of a cell (six axes), and of axes (six, and the dummy axis without inner axes)."""
PER_CELL = 2048
"""Displacements are stored in units of 1 / PER_CELL cells: 16 bits hold up to 15 cells."""
_CELL = 1.0 / PER_CELL
_ALL = 0.99  # weight of the start node above which a step leads nowhere

GRID = np.dtype(
    [
        ("n", np.int64),
        ("n_outer", np.int64),
        ("counts", np.int64, MOST_AXES),
        ("strides", np.int64, MOST_AXES),
        ("periodic", np.uint8, MOST_AXES),
    ],
    align=True,
)
"""The n axes in the layout's order, the n_outer outer axes first; strides are in nodes, periodic is 0 or 1. The last
axis is an inner one."""

OFFSETS = np.dtype(
    [
        ("number", np.int64),
        ("own", np.float32),
        ("outer", np.int64, MOST_CORNERS),
        ("shift", np.int64, (MOST_CORNERS, MOST_AXES)),
        ("weight", np.float32, MOST_CORNERS),
    ],
    align=True,
)
"""Nodes around the end of one pair's step from a slab.

Fields:
    number: Number of corners, or of curves; 0 if the step leaves the grid.
    own: Weight of the start node, which is excluded from the corners; the weights of the others sum to 1 without it.
    outer: Offset of each node's slab [nodes].
    shift: Cells from the start to each node along each inner axis.
    weight: Weight of each corner, or of each curve.
"""

Grid = Any
"""Record of the dtype `GRID`."""
Offsets = Any
"""Record or array of records of the dtype `OFFSETS`."""
Integers = NDArray[np.int64]
Floats = NDArray[np.float32]


class StepTable(NamedTuple):
    """Steps of each slab under each pair of disturbance and control, as in `solvers.steps.Steps`.

    Attributes:
        codes: Code of each step's duration (slabs, pairs); 0 if there is no step.
        ends: Displacements at the end (slabs, pairs, n) [1 / PER_CELL cells].
        ranges: Lowest and highest cell of a step's path along each inner axis (slabs, pairs, inner, 2).
        long: Whether the steps of each pair are long (pairs,): such a step must end where all corners are reachable and
            smooth.
        controls: Number of controls; the control is the fastest-varying index of the pairs.
        discounts: Discount exp(-rate h) by duration code; 0 for code 0.
        durations: Duration h by code [s].
    """

    codes: NDArray[np.uint16]
    ends: NDArray[np.int16]
    ranges: NDArray[np.int8]
    long: NDArray[np.bool_]
    controls: int
    discounts: Floats
    durations: NDArray[np.float64]


class SlabOffsets(NamedTuple):
    """Nodes around the ends of the steps from one slab, one record per pair.

    Attributes:
        corners: Up to 2^n corners (pairs,) of the cell in which each step ends. If the last axis is interpolated, the
            second half repeats the first, one cell further along it.
        curves: Four nodes in a line (pairs,) along each axis on which the step ends between nodes: nodes 4 q to 4 q + 3
            belong to curve q.
    """

    corners: Offsets
    curves: Offsets


def make_grid(counts: Integers, periodic: NDArray[np.bool_], n_outer: int) -> Grid:
    """Return the record of a grid.

    Args:
        counts: Number of nodes on each axis (n,), in the layout's order.
        periodic: Whether each axis is periodic (n,).
        n_outer: Number of outer axes.
    """
    record = np.zeros(1, GRID)
    n = len(counts)
    record["n"], record["n_outer"] = n, n_outer
    record["counts"][0, :n], record["periodic"][0, :n] = counts, periodic
    record["strides"][0, :n] = np.concatenate((np.cumprod(counts[:0:-1])[::-1], [1]))
    return record[0]


@njit(**_OPTIONS)
def place_corners(grid: Grid, index: Integers, move: NDArray[np.int16], corners: Offsets) -> None:
    """Fill in one pair's corners for the slab at `index` (n,) and the displacement `move` (n,) [1 / PER_CELL cells]."""
    size = 1
    corners.number, corners.outer[0], corners.weight[0] = 0, 0, 1.0
    for k in range(grid.n):
        position = _CELL * move[k]
        if k < grid.n_outer:
            position += index[k]
        lower = int(np.floor(position))
        upper_weight = float(position - lower)
        upper = lower + 1
        if k < grid.n_outer:
            if grid.periodic[k]:
                lower, upper = lower % grid.counts[k], upper % grid.counts[k]
            else:
                # A step truncated at the edge ends there only up to rounding.
                if lower == -1 and upper_weight > 0.999:
                    lower, upper_weight = 0, 0.0
                if lower == grid.counts[k] - 1 and upper_weight < 0.001:
                    upper_weight = 0.0
                if lower < 0 or lower + (upper_weight > 0.0) >= grid.counts[k]:
                    return
        between = upper_weight > 0.0
        for c in range(size):
            if between:
                corners.weight[size + c] = corners.weight[c] * upper_weight
                corners.weight[c] *= 1.0 - upper_weight
                corners.outer[size + c] = corners.outer[c]
                for j in range(grid.n - grid.n_outer):
                    corners.shift[size + c, j] = corners.shift[c, j]
            if k < grid.n_outer:
                if between:
                    corners.outer[size + c] += upper * grid.strides[k]
                corners.outer[c] += lower * grid.strides[k]
            else:
                if between:
                    corners.shift[size + c, k - grid.n_outer] = upper
                corners.shift[c, k - grid.n_outer] = lower
        if between:
            size *= 2
    corners.number = _without_own(grid, index, size, corners)


@njit(**_OPTIONS)
def _without_own(grid: Grid, index: Integers, size: int, corners: Offsets) -> int:
    """Exclude the start node from the corners; return the number of remaining corners, 0 if they weigh too little.

    A step of less than a cell, which a game may need, ends in a cell of its start node. Its update w = D (a w + b) is
    solved for w = D b / (1 - D a), so the node does not depend on itself to be reachable and converges quickly.
    """
    corners.own = np.float32(0.0)
    here = np.int64(0)
    for k in range(grid.n_outer):
        here += index[k] * grid.strides[k]
    for c in range(size):
        same = corners.outer[c] == here
        for j in range(grid.n - grid.n_outer):
            same &= corners.shift[c, j] == 0
        if same:
            own = corners.weight[c]
            if own > _ALL:
                return 0
            last = size - 1
            corners.outer[c], corners.weight[c] = corners.outer[last], corners.weight[last]
            for j in range(grid.n - grid.n_outer):
                corners.shift[c, j] = corners.shift[last, j]
            for other in range(last):
                corners.weight[other] /= np.float32(1.0) - own
            corners.own = own
            return last
    return size


@njit(**_OPTIONS)
def place_curves(grid: Grid, index: Integers, move: NDArray[np.int16], curves: Offsets) -> None:
    """Fill in one pair's curves, as `place_corners` does; an axis on which four nodes do not fit has none."""
    n = grid.n
    curves.number = 0
    for k in range(n):
        position = _CELL * move[k]
        if k < grid.n_outer:
            position += index[k]
        lower = int(np.floor(position))
        part = position - lower
        outside = k < grid.n_outer and not grid.periodic[k] and (lower < 1 or lower + 2 >= grid.counts[k])
        if part < 1e-3 or part > 1.0 - 1e-3 or outside:
            continue
        q = curves.number
        curves.number += 1
        # Linear interpolation between the middle two nodes omits the second difference times this weight.
        curves.weight[q] = -0.5 * part * (1.0 - part)
        for i in range(4):
            curves.outer[4 * q + i] = 0
            for m in range(n):
                if m < grid.n_outer:
                    at = lower - 1 + i if m == k else int(np.round(index[m] + _CELL * move[m]))
                    at = at % grid.counts[m] if grid.periodic[m] else min(max(at, 0), grid.counts[m] - 1)
                    curves.outer[4 * q + i] += at * grid.strides[m]
                else:
                    curves.shift[4 * q + i, m - grid.n_outer] = (
                        lower - 1 + i if m == k else int(np.round(_CELL * move[m]))
                    )
