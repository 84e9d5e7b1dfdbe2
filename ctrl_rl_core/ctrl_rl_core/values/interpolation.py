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
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_core.values.grid_axis import Axis, GridError
from ctrl_rl_core.values.jit_cache import cached_njit

Values = NDArray[np.float32] | NDArray[np.float64]
Axes = NDArray[np.float64]
States = NDArray[np.float64]
Offsets = NDArray[np.int64]
Weights = NDArray[np.float64]
Vector = NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])

# Columns of the table that `axis_table` makes, one row an axis.
_ORIGIN, _LOWEST, _HIGHEST, _PER_UNIT, _PERIOD, _PER_PERIOD, _LAST_CELL, _COUNT, _STRIDE = range(9)

_BLOCK = 64
"""States that are interpolated together: their corners fit into the processor's nearest cache."""

# NumPy's error model: no check for a division by zero.
_OPTIONS = {"error_model": "numpy"}


def axis_table(axes: Sequence[Axis]) -> NDArray[np.float64]:
    """Return the axes as the table (n, 9) of the kernels: no bounds on a periodic axis, period 0 on any other."""
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
    return cast("Function", cached_njit(function, **_OPTIONS))


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
def _value_beside_infinity(values: Values, axes: Axes, state: Vector) -> float:
    """Value at a state (n,) that has a corner at +inf or lies outside."""
    n = values.ndim
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    if not _locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        return np.nan
    return _finite_cell_value(n, values.reshape(values.size), offsets, weights)


@_compiled
def _gradient_beside_infinity(values: Values, axes: Axes, state: Vector, gradient: Vector) -> float:
    """Value at a state (n,) as above; fills gradient (n,)."""
    n = values.ndim
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    gradient[:] = np.nan
    if not _locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        return np.nan
    corners = values.reshape(values.size)
    value = _finite_cell_value(n, corners, offsets, weights)
    if value < np.inf:
        _finite_cell_gradient(n, corners, axes, offsets, weights, value, gradient)
    return value


@_inlined
def _locate_block(axis: Vector, coordinates: Vector, size: int, lower: Vector, upper: Vector, weights: Vector) -> None:
    """As `_locate` along one axis, for the first `size` coordinates: node offsets, upper weights, NaN outside."""
    # The axis in local variables and branch-free arithmetic on floats alone: so the compiler makes vectors of it.
    origin, per_unit, lowest, highest = axis[_ORIGIN], axis[_PER_UNIT], axis[_LOWEST], axis[_HIGHEST]
    period, per_period = axis[_PERIOD], axis[_PER_PERIOD]
    last_cell, count, stride = axis[_LAST_CELL], axis[_COUNT], axis[_STRIDE]
    for i in range(size):
        position = (coordinates[i] - origin) * per_unit
        position -= np.floor(position * per_period) * period
        inside = (coordinates[i] >= lowest) & (coordinates[i] <= highest) & (position == position)
        cell = position if position > 0.0 else 0.0
        cell = np.floor(cell if cell < last_cell else last_cell)
        weight = position - cell
        weight = weight if weight > 0.0 else 0.0
        weight = weight if weight < 1.0 else 1.0
        weights[i] = weight if inside else np.nan
        lower[i] = np.int64(cell * stride)
        upper[i] = np.int64((cell + 1.0 if cell + 1.0 < count else 0.0) * stride)


@_inlined
def _locate_blocks(
    n: int, axes: Axes, states: States, first: int, size: int, offsets: Any, weights: Any, coordinates: Vector
) -> None:
    """Fill offsets (n, 2, block) and upper weights (n, block) of the `size` states from `first` on."""
    for k in range(n):
        for i in range(size):
            coordinates[i] = states[first + i, k]
        _locate_block(axes[k], coordinates, size, offsets[k, 0], offsets[k, 1], weights[k])


@_inlined
def _gather_block(n: int, corners: Values, size: int, offsets: Any, out: Any) -> None:
    """Fill out (2^n, block) with the corners of each state's cell; bit k of the row tells the node along axis k."""
    for corner in range(1 << n):
        for i in range(size):
            offset = 0
            for k in range(n):
                offset += offsets[k, (corner >> k) & 1, i]
            out[corner, i] = corners[offset]


@_inlined
def _mix(rows: int, size: int, weights: Vector, values: Any) -> None:
    """Interpolate along one axis: values[row] between the lower values[row] and the upper values[row + rows]."""
    for row in range(rows):
        for i in range(size):
            values[row, i] = (1.0 - weights[i]) * values[row, i] + weights[i] * values[row + rows, i]


@_compiled
def values_at(values: Values, axes: Axes, states: States, out: Vector) -> None:
    """Fill out (N,) with the values at the states (N, n)."""
    # In blocks, of which the processor does several states in one instruction.
    n = values.ndim
    _check_size(n, states.shape[1])
    corners = values.reshape(values.size)
    block = min(_BLOCK, states.shape[0])
    offsets, rows = np.empty((n, 2, block), np.int64), np.empty((n + 1 + (1 << n), block))
    weights, coordinates, mixed = rows[:n], rows[n], rows[n + 1 :]
    for first in range(0, states.shape[0], _BLOCK):
        size = min(_BLOCK, states.shape[0] - first)
        _locate_blocks(n, axes, states, first, size, offsets, weights, coordinates)
        _gather_block(n, corners, size, offsets, mixed)
        for k in range(n - 1, -1, -1):
            _mix(1 << k, size, weights[k], mixed)
        for i in range(size):
            out[first + i] = mixed[0, i]
            if mixed[0, i] - mixed[0, i] != 0.0:  # outside, or beside +inf
                out[first + i] = _value_beside_infinity(values, axes, states[first + i])


@_compiled
def gradients_at(values: Values, axes: Axes, states: States, out: Vector, gradients: States) -> None:
    """Fill out (N,) and gradients (N, n) at the states (N, n)."""
    n = values.ndim
    _check_size(n, states.shape[1])
    corners = values.reshape(values.size)
    block = min(_BLOCK, states.shape[0])
    offsets, rows = np.empty((n, 2, block), np.int64), np.empty((n + 1, block))
    weights, coordinates = rows[:n], rows[n]
    mixed, slopes = np.empty((1 << n, block)), np.empty((n, 1 << (n - 1), block))
    for first in range(0, states.shape[0], _BLOCK):
        size = min(_BLOCK, states.shape[0] - first)
        _locate_blocks(n, axes, states, first, size, offsets, weights, coordinates)
        _gather_block(n, corners, size, offsets, mixed)
        for k in range(n - 1, -1, -1):
            for row in range(1 << k):
                for i in range(size):
                    slopes[k, row, i] = mixed[row + (1 << k), i] - mixed[row, i]
            for j in range(k + 1, n):
                _mix(1 << k, size, weights[k], slopes[j])
            _mix(1 << k, size, weights[k], mixed)
        for i in range(size):
            out[first + i] = total = mixed[0, i]
            for k in range(n):
                gradients[first + i, k] = slopes[k, 0, i] * axes[k, _PER_UNIT]
                total += slopes[k, 0, i]
            if total - total != 0.0:  # outside, or beside +inf
                out[first + i] = _gradient_beside_infinity(values, axes, states[first + i], gradients[first + i])


@_compiled
def value_at(values: Values, axes: Axes, state: Vector) -> float:
    """Value at one state (n,); `values` is C-contiguous with n dimensions, `axes` from `axis_table`."""
    # The arithmetic of `values_at` in the same order, without its blocks: one state takes half the time.
    n = values.ndim
    _check_size(n, state.size)
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    if not _locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        return np.nan
    corners = values.reshape(values.size)
    mixed = np.empty(1 << n)
    for corner in range(1 << n):
        offset = 0
        for k in range(n):
            offset += offsets[k, (corner >> k) & 1]
        mixed[corner] = corners[offset]
    for k in range(n - 1, -1, -1):
        for row in range(1 << k):
            mixed[row] = weights[k, 0] * mixed[row] + weights[k, 1] * mixed[row + (1 << k)]
    if mixed[0] - mixed[0] == 0.0:  # finite
        return mixed[0]
    return _finite_cell_value(n, corners, offsets, weights)


@_compiled
def gradient_at(values: Values, axes: Axes, state: Vector, gradient: Vector) -> float:
    """Value at one state (n,); fills gradient (n,)."""
    out = np.empty(1)
    gradients_at(values, axes, state.reshape(1, state.size), out, gradient.reshape(1, gradient.size))
    return out[0]
