"""Cells of a regular grid: an axis table, and the location of states along the axes, compiled by Numba."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_core.values.grid_axis import Axis
from ctrl_rl_core.values.jit_cache import cached_njit

Values = NDArray[np.float32] | NDArray[np.float64]
Axes = NDArray[np.float64]
States = NDArray[np.float64]
Offsets = NDArray[np.int64]
Weights = NDArray[np.float64]
Vector = NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])

# Columns of the table from `axis_table`, one row per axis.
ORIGIN, LOWEST, HIGHEST, PER_UNIT, PERIOD, PER_PERIOD, LAST_CELL, COUNT, STRIDE = range(9)

# NumPy's error model: no check for division by zero.
_OPTIONS = {"error_model": "numpy"}


def axis_table(axes: Sequence[Axis]) -> NDArray[np.float64]:
    """Return the axis table (n, 9) of the kernels; periodic axes have infinite bounds, other axes period 0."""
    table = np.zeros((len(axes), 9))
    stride = 1
    for row, axis in reversed(list(zip(table, axes, strict=True))):
        row[ORIGIN] = axis.lower
        row[LOWEST], row[HIGHEST] = (-np.inf, np.inf) if axis.periodic else (axis.lower, axis.upper)
        row[PER_UNIT] = 1 / axis.spacing
        row[PERIOD], row[PER_PERIOD] = (axis.count, 1 / axis.count) if axis.periodic else (0, 0)
        row[LAST_CELL] = axis.count - (1 if axis.periodic else 2)
        row[COUNT], row[STRIDE] = axis.count, stride
        stride *= axis.count
    return table


def compiled(function: Function) -> Function:
    """Compile lazily, with machine code cached on disk if possible (compiling takes seconds on a Raspberry Pi)."""
    return cast("Function", cached_njit(function, **_OPTIONS))


def inlined(function: Function) -> Function:
    """Compile into the caller, where a constant number of dimensions lets small loops unroll."""
    return njit(forceinline=True, **_OPTIONS)(function)


@inlined
def locate(axes: Axes, k: int, coordinate: float) -> tuple[bool, int, int, float]:
    """Locate a coordinate on axis k: whether it is inside, offsets of the lower and upper node, upper weight."""
    # Branch-free, because mispredicted branches cost several times the arithmetic.
    position = (coordinate - axes[k, ORIGIN]) * axes[k, PER_UNIT]
    position -= np.floor(position * axes[k, PER_PERIOD]) * axes[k, PERIOD]
    # The last comparison is false for NaN, which results from infinity on a periodic axis.
    inside = coordinate >= axes[k, LOWEST] and coordinate <= axes[k, HIGHEST] and position == position
    # Clipped before the conversion to an integer, so that no state can address memory outside the grid.
    cell = position if position > 0.0 else 0.0
    cell = cell if cell < axes[k, LAST_CELL] else axes[k, LAST_CELL]
    lower = int(cell)
    upper = lower + 1
    if upper >= int(axes[k, COUNT]):
        upper = 0
    weight = position - lower
    weight = weight if weight > 0.0 else 0.0
    weight = weight if weight < 1.0 else 1.0
    stride = int(axes[k, STRIDE])
    return inside, lower * stride, upper * stride, weight


@inlined
def locate_cell(n: int, axes: Axes, states: States, row: int, offsets: Offsets, weights: Weights) -> bool:
    """Fill offsets and weights (n, 2) of each axis's lower and upper node; return whether states[row] is inside."""
    inside = True
    for k in range(n):
        ok, offsets[k, 0], offsets[k, 1], upper = locate(axes, k, states[row, k])
        weights[k, 0] = 1.0 - upper
        weights[k, 1] = upper
        inside &= ok
    return inside
