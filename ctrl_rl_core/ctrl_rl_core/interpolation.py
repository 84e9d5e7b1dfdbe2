"""Multilinear interpolation on a regular grid of one to six dimensions, compiled by Numba.

Inside a cell the value is the average of its 2^n corners with the multilinear weights, and the gradient is the exact derivative of that
average. On a face between cells (where the gradient jumps) the cell on the upper side counts, on the last face the last cell.

Corners at +inf ("cannot reach"): the corners with finite values are averaged alone, with their weights scaled to sum to one, if they
carry at least half of the weight; otherwise the value is +inf and the gradient NaN. So the edge of what can be reached lies half-way
between nodes, on average neither grown nor shrunk, and a corridor one node wide stays open. (Infinite as soon as one corner is would
widen every obstacle by a cell; finite as long as one corner is would thin it by a cell.)

States outside, and those that are not finite, give NaN. Nothing is extrapolated.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_core.grid_axis import Axis, GridError

Values = NDArray[np.float32] | NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])

# Columns of the table that `axis_table` makes, one row an axis.
_ORIGIN, _LOWEST, _HIGHEST, _PER_UNIT, _PERIOD, _PER_PERIOD, _LAST_CELL, _COUNT, _STRIDE = range(9)


def axis_table(axes: Sequence[Axis]) -> NDArray[np.float64]:
    """What the kernels need of the axes, shape (n, 9). A periodic axis has no lowest and highest state; another has period 0."""
    table = np.zeros((len(axes), 9))
    stride = 1
    for row, axis in reversed(list(zip(table, axes, strict=True))):
        row[_ORIGIN] = axis.lower
        row[_LOWEST], row[_HIGHEST] = (-np.inf, np.inf) if axis.periodic else (axis.lower, axis.upper)
        row[_PER_UNIT] = 1 / axis.spacing
        row[_PERIOD], row[_PER_PERIOD] = (axis.count, 1 / axis.count) if axis.periodic else (0, 0)
        row[_LAST_CELL] = axis.count - (1 if axis.periodic else 2)
        row[_COUNT], row[_STRIDE] = axis.count, stride
        stride *= axis.count
    return table


def _compiled(function: Function) -> Function:
    """Compile lazily; keep the machine code on disk (a Raspberry Pi compiles for seconds) where a folder can be written."""
    try:
        return njit(cache=True, error_model="numpy", nogil=True)(function)
    except RuntimeError:  # no writable cache folder: a read-only installation without a home
        return njit(error_model="numpy", nogil=True)(function)


@_compiled
def _locate(axes: NDArray[np.float64], k: int, coordinate: float) -> tuple[bool, int, int, float]:
    """Along axis k: whether the coordinate is inside, offsets of the nodes below and above, weight of the upper one."""
    # Free of branches: mispredicted ones cost several times the arithmetic.
    position = (coordinate - axes[k, _ORIGIN]) * axes[k, _PER_UNIT]
    position -= math.floor(position * axes[k, _PER_PERIOD]) * axes[k, _PERIOD]
    # NaN, and infinity on a periodic axis, are unequal to themselves here.
    inside = coordinate >= axes[k, _LOWEST] and coordinate <= axes[k, _HIGHEST] and position == position  # noqa: PLR0124
    # Clipped before it becomes an integer, so that no state whatever can address memory outside the grid.
    cell = position if position > 0.0 else 0.0
    cell = cell if cell < axes[k, _LAST_CELL] else axes[k, _LAST_CELL]
    lower = np.int64(cell)
    upper = lower + 1
    if upper >= np.int64(axes[k, _COUNT]):
        upper = 0
    weight = position - lower
    weight = weight if weight > 0.0 else 0.0
    weight = weight if weight < 1.0 else 1.0
    stride = np.int64(axes[k, _STRIDE])
    return inside, lower * stride, upper * stride, weight


@_compiled
def _locate_cell(
    axes: NDArray[np.float64], state: NDArray[np.float64], offsets: NDArray[np.int64], weights: NDArray[np.float64]
) -> bool:
    """Fill offsets and weights (n, 2) of the cell's lower and upper nodes per axis; return whether the state is inside."""
    inside = True
    for k in range(axes.shape[0]):
        ok, offsets[k, 0], offsets[k, 1], upper = _locate(axes, k, state[k])
        weights[k, 0] = 1.0 - upper
        weights[k, 1] = upper
        inside &= ok
    return inside


@_compiled
def _corner_average(values: Values, n: int, offsets: NDArray[np.int64], weights: NDArray[np.float64]) -> float:
    """The interpolated value in a cell: the weighted sum over its corners, or the rule for +inf."""
    total = 0.0
    last = n - 1
    for corner in range(1 << last):
        weight = 1.0
        offset = 0
        for k in range(last):
            bit = (corner >> k) & 1
            weight *= weights[k, bit]
            offset += offsets[k, bit]
        total += weight * (
            weights[last, 0] * values[offset + offsets[last, 0]] + weights[last, 1] * values[offset + offsets[last, 1]]
        )
    if total - total == 0.0:
        return total
    return _finite_corner_average(values, n, offsets, weights)


@_compiled
def _finite_corner_average(values: Values, n: int, offsets: NDArray[np.int64], weights: NDArray[np.float64]) -> float:
    """The average over the corners that are finite, if they carry at least half of the weight, else +inf."""
    total = 0.0
    finite_weight = 0.0
    for corner in range(1 << n):
        weight = 1.0
        offset = 0
        for k in range(n):
            bit = (corner >> k) & 1
            weight *= weights[k, bit]
            offset += offsets[k, bit]
        if values[offset] < np.inf:
            total += weight * values[offset]
            finite_weight += weight
    return total / finite_weight if finite_weight >= 0.5 else np.inf


@_compiled
def _corner_gradient(
    values: Values,
    axes: NDArray[np.float64],
    offsets: NDArray[np.int64],
    weights: NDArray[np.float64],
    value: float,
    gradient: NDArray[np.float64],
) -> None:
    """Derivative of sum(w v) / sum(w) over the finite corners; `value` is that quotient, 1 its denominator where none is infinite."""
    n = axes.shape[0]
    gradient[:] = 0.0
    finite_weight = 0.0
    for corner in range(1 << n):
        offset = 0
        for k in range(n):
            offset += offsets[k, (corner >> k) & 1]
        if not values[offset] < np.inf:
            continue
        # Subtracting the value costs nothing where all corners count (the derivatives of the weights sum to zero).
        difference = values[offset] - value
        corner_weight = 1.0
        for k in range(n):
            corner_weight *= weights[k, (corner >> k) & 1]
            slope = difference if (corner >> k) & 1 else -difference
            for j in range(n):
                if j != k:
                    slope *= weights[j, (corner >> j) & 1]
            gradient[k] += slope
        finite_weight += corner_weight
    for k in range(n):
        gradient[k] *= axes[k, _PER_UNIT] / finite_weight


@_compiled
def _check_size(values: Values, count: int) -> None:
    if count != values.ndim:
        raise GridError("the state has not as many components as the grid has axes")


@_compiled
def value_at(values: Values, axes: NDArray[np.float64], state: NDArray[np.float64]) -> float:
    """Value at one state (n,); `values` is C-contiguous with n dimensions, `axes` from `axis_table`."""
    n = values.ndim
    _check_size(values, state.size)
    offsets = np.empty((n, 2), np.int64)
    weights = np.empty((n, 2))
    if not _locate_cell(axes, state, offsets, weights):
        return np.nan
    return _corner_average(values.reshape(values.size), n, offsets, weights)


@_compiled
def gradient_at(
    values: Values, axes: NDArray[np.float64], state: NDArray[np.float64], gradient: NDArray[np.float64]
) -> float:
    """Value at one state (n,); fills the gradient (n,) with d value / d state."""
    n = values.ndim
    _check_size(values, state.size)
    offsets = np.empty((n, 2), np.int64)
    weights = np.empty((n, 2))
    gradient[:] = np.nan
    if not _locate_cell(axes, state, offsets, weights):
        return np.nan
    corners = values.reshape(values.size)
    value = _corner_average(corners, n, offsets, weights)
    if value < np.inf:
        _corner_gradient(corners, axes, offsets, weights, value, gradient)
    return value


@_compiled
def values_at(values: Values, axes: NDArray[np.float64], states: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill out (N,) with the values at the states (N, n)."""
    n = values.ndim
    _check_size(values, states.shape[1])
    corners = values.reshape(values.size)
    offsets = np.empty((n, 2), np.int64)
    weights = np.empty((n, 2))
    for i in range(states.shape[0]):
        if _locate_cell(axes, states[i], offsets, weights):
            out[i] = _corner_average(corners, n, offsets, weights)
        else:
            out[i] = np.nan


@_compiled
def gradients_at(
    values: Values,
    axes: NDArray[np.float64],
    states: NDArray[np.float64],
    out: NDArray[np.float64],
    gradients: NDArray[np.float64],
) -> None:
    """Fill out (N,) and gradients (N, n) at the states (N, n)."""
    for i in range(states.shape[0]):
        out[i] = gradient_at(values, axes, states[i], gradients[i])
