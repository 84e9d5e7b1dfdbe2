"""Multilinear interpolation on a regular grid of one to six dimensions, compiled by Numba.

Inside a cell the value is the average of its 2^n corners with the multilinear weights, and the gradient is the exact
derivative of that average. On a face between cells (where the gradient jumps) the cell on the upper side counts, on the
last face the last cell.

Corners at +inf ("cannot reach"): the corners with finite values are averaged alone, with their weights scaled to sum to
one, if they carry at least half of the weight; otherwise the value is +inf and the gradient NaN. So the edge of what
can be reached lies half-way between nodes, on average neither grown nor shrunk, and a corridor one node wide stays
open. (Infinite as soon as one corner is would widen every obstacle by a cell; finite as long as one corner is would
thin it by a cell.)

States outside, and those that are not finite, give NaN. Nothing is extrapolated.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_core.grid_axis import Axis, GridError

Values = NDArray[np.float32] | NDArray[np.float64]
Axes = NDArray[np.float64]
States = NDArray[np.float64]
Offsets = NDArray[np.int64]
Weights = NDArray[np.float64]
Vector = NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])

# Columns of the table that `axis_table` makes, one row an axis.
_ORIGIN, _LOWEST, _HIGHEST, _PER_UNIT, _PERIOD, _PER_PERIOD, _LAST_CELL, _COUNT, _STRIDE = range(9)

# NumPy's error model: no check for a division by zero.
_OPTIONS = {"error_model": "numpy"}


def axis_table(axes: Sequence[Axis]) -> NDArray[np.float64]:
    """Tabulate what the kernels need of the axes, shape (n, 9): no bounds on a periodic axis, period 0 on any other."""
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
    """Compile lazily; keep the machine code on disk (a Raspberry Pi compiles for seconds) where that is possible."""
    try:
        return njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # no writable cache folder: a read-only installation without a home
        return njit(**_OPTIONS)(function)


def _inlined(function: Function) -> Function:
    """Compile into the caller, where the number of dimensions is a constant and the small loops unroll."""
    return njit(forceinline=True, **_OPTIONS)(function)


@_inlined
def _locate(axes: Axes, k: int, coordinate: float) -> tuple[bool, int, int, float]:
    """Along axis k: whether the coordinate is inside, offsets of the nodes below and above, weight of the upper one."""
    # Free of branches: mispredicted ones cost several times the arithmetic.
    position = (coordinate - axes[k, _ORIGIN]) * axes[k, _PER_UNIT]
    position -= np.floor(position * axes[k, _PER_PERIOD]) * axes[k, _PERIOD]
    # The last comparison is false for NaN, which infinity becomes on a periodic axis.
    inside = coordinate >= axes[k, _LOWEST] and coordinate <= axes[k, _HIGHEST] and position == position
    # Clipped before it becomes an integer, so that no state whatever can address memory outside the grid.
    cell = position if position > 0.0 else 0.0
    cell = cell if cell < axes[k, _LAST_CELL] else axes[k, _LAST_CELL]
    lower = int(cell)
    upper = lower + 1
    if upper >= int(axes[k, _COUNT]):
        upper = 0
    weight = position - lower
    weight = weight if weight > 0.0 else 0.0
    weight = weight if weight < 1.0 else 1.0
    stride = int(axes[k, _STRIDE])
    return inside, lower * stride, upper * stride, weight


@_inlined
def _locate_cell(n: int, axes: Axes, states: States, row: int, offsets: Offsets, weights: Weights) -> bool:
    """Fill offsets and weights (n, 2) of each axis's lower and upper node; return whether states[row] is inside."""
    inside = True
    for k in range(n):
        ok, offsets[k, 0], offsets[k, 1], upper = _locate(axes, k, states[row, k])
        weights[k, 0] = 1.0 - upper
        weights[k, 1] = upper
        inside &= ok
    return inside


@_inlined
def _cell_value(n: int, corners: Values, offsets: Offsets, weights: Weights) -> float:
    """Interpolate in a cell: the weighted sum over its corners, or the rule for +inf."""
    total = 0.0
    last = n - 1
    for corner in range(1 << last):
        weight, offset = 1.0, 0
        for k in range(last):
            bit = (corner >> k) & 1
            weight *= weights[k, bit]
            offset += offsets[k, bit]
        lower, upper = corners[offset + offsets[last, 0]], corners[offset + offsets[last, 1]]
        total += weight * (weights[last, 0] * lower + weights[last, 1] * upper)
    if total - total == 0.0:  # finite
        return total
    return _finite_cell_value(n, corners, offsets, weights)


@_compiled
def _finite_cell_value(n: int, corners: Values, offsets: Offsets, weights: Weights) -> float:
    """Average over the corners that are finite, if they carry at least half of the weight, else +inf."""
    total, finite_weight = 0.0, 0.0
    for corner in range(1 << n):
        weight, offset = 1.0, 0
        for k in range(n):
            bit = (corner >> k) & 1
            weight *= weights[k, bit]
            offset += offsets[k, bit]
        if corners[offset] < np.inf:
            total += weight * corners[offset]
            finite_weight += weight
    return total / finite_weight if finite_weight >= 0.5 else np.inf


@_inlined
def _cell_gradient(
    n: int, corners: Values, axes: Axes, offsets: Offsets, weights: Weights, value: float, gradients: States, row: int
) -> None:
    """Fill gradients[row] (n,): along each axis the mean difference over the cell's edges, or the rule for +inf."""
    if not value < np.inf:
        gradients[row, :] = np.nan
        return
    total = 0.0
    for k in range(n):
        difference = 0.0
        for corner in range(1 << (n - 1)):
            weight, offset = 1.0, 0
            for j in range(n - 1):
                other = j + 1 if j >= k else j
                bit = (corner >> j) & 1
                weight *= weights[other, bit]
                offset += offsets[other, bit]
            difference += weight * (corners[offset + offsets[k, 1]] - corners[offset + offsets[k, 0]])
        gradients[row, k] = difference * axes[k, _PER_UNIT]
        total += difference
    if total - total != 0.0:  # not finite
        _finite_cell_gradient(n, corners, axes, offsets, weights, value, gradients[row])


@_compiled
def _finite_cell_gradient(
    n: int, corners: Values, axes: Axes, offsets: Offsets, weights: Weights, value: float, gradient: Vector
) -> None:
    """Differentiate `value` = sum(w v) / sum(w) over the finite corners: sum(w' (v - value)) / sum(w)."""
    gradient[:] = 0.0
    finite_weight = 0.0
    for corner in range(1 << n):
        offset = 0
        for k in range(n):
            offset += offsets[k, (corner >> k) & 1]
        if not corners[offset] < np.inf:
            continue
        corner_weight = 1.0
        for k in range(n):
            upper = (corner >> k) & 1
            corner_weight *= weights[k, upper]
            slope = axes[k, _PER_UNIT] * (corners[offset] - value)
            for j in range(n):
                if j != k:
                    slope *= weights[j, (corner >> j) & 1]
            gradient[k] += slope if upper else -slope
        finite_weight += corner_weight
    gradient /= finite_weight


@_inlined
def _check_size(n: int, size: int) -> None:
    if size != n:
        raise GridError("the state has not as many components as the grid has axes")


@_compiled
def value_at(values: Values, axes: Axes, state: Vector) -> float:
    """Value at one state (n,); `values` is C-contiguous with n dimensions, `axes` from `axis_table`."""
    n = values.ndim
    _check_size(n, state.size)
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    if not _locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        return np.nan
    return _cell_value(n, values.reshape(values.size), offsets, weights)


@_compiled
def gradient_at(values: Values, axes: Axes, state: Vector, gradient: Vector) -> float:
    """Value at one state (n,); fills gradient (n,)."""
    n = values.ndim
    _check_size(n, state.size)
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    if not _locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        gradient[:] = np.nan
        return np.nan
    corners = values.reshape(values.size)
    value = _cell_value(n, corners, offsets, weights)
    _cell_gradient(n, corners, axes, offsets, weights, value, gradient.reshape(1, n), 0)
    return value


@_compiled
def values_at(values: Values, axes: Axes, states: States, out: Vector) -> None:
    """Fill out (N,) with the values at the states (N, n)."""
    n = values.ndim
    _check_size(n, states.shape[1])
    corners = values.reshape(values.size)
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    for row in range(states.shape[0]):
        inside = _locate_cell(n, axes, states, row, offsets, weights)
        out[row] = _cell_value(n, corners, offsets, weights) if inside else np.nan


@_compiled
def gradients_at(values: Values, axes: Axes, states: States, out: Vector, gradients: States) -> None:
    """Fill out (N,) and gradients (N, n) at the states (N, n)."""
    n = values.ndim
    _check_size(n, states.shape[1])
    corners = values.reshape(values.size)
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    for row in range(states.shape[0]):
        if _locate_cell(n, axes, states, row, offsets, weights):
            value = _cell_value(n, corners, offsets, weights)
            _cell_gradient(n, corners, axes, offsets, weights, value, gradients, row)
            out[row] = value
        else:
            out[row] = np.nan
            gradients[row, :] = np.nan
