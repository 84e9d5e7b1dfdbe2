"""Multilinear interpolation on a regular grid of one to six dimensions, compiled by Numba.

Inside a cell the value is the average of its 2^n corners with the multilinear weights, and the gradient is the exact
derivative of that average. On a face between cells (where the gradient jumps) the upper cell is used; on the last face,
the last cell.

Corners at +inf (unreachable): if the finite corners carry at least half of the weight, only they are averaged, with
their weights rescaled to sum to one; otherwise the value is +inf and the gradient NaN. The boundary of the reachable
set therefore lies half-way between nodes, on average neither grown nor shrunk, and a corridor one node wide stays open.
(Returning +inf for any infinite corner would widen every obstacle by a cell; returning a finite value for any finite
corner would thin it by a cell.)

States outside the grid and non-finite states give NaN; there is no extrapolation.
"""

from typing import Any

import numpy as np

from ctrl_rl_core.values.cells import (
    COUNT,
    HIGHEST,
    LAST_CELL,
    LOWEST,
    ORIGIN,
    PER_PERIOD,
    PER_UNIT,
    PERIOD,
    STRIDE,
    Axes,
    Offsets,
    States,
    Values,
    Vector,
    Weights,
    compiled,
    inlined,
    locate_cell,
)
from ctrl_rl_core.values.grid_axis import GridError

_BLOCK = 64
"""States interpolated per block, so that their corners fit into the L1 cache."""


@compiled
def _finite_cell_value(n: int, corners: Values, offsets: Offsets, weights: Weights) -> float:
    """Average the finite corners if they carry at least half of the weight; else return +inf."""
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


@compiled
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
            slope = axes[k, PER_UNIT] * (corners[offset] - value)
            for j in range(n):
                if j != k:
                    slope *= weights[j, (corner >> j) & 1]
            gradient[k] += slope if upper else -slope
        finite_weight += corner_weight
    gradient /= finite_weight


@inlined
def _check_size(n: int, size: int) -> None:
    if size != n:
        raise GridError("the state has not as many components as the grid has axes")


@compiled
def _value_beside_infinity(values: Values, axes: Axes, state: Vector) -> float:
    """Return the value at a state (n,) that has a corner at +inf or lies outside."""
    n = values.ndim
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    if not locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        return np.nan
    return _finite_cell_value(n, values.reshape(values.size), offsets, weights)


@compiled
def _gradient_beside_infinity(values: Values, axes: Axes, state: Vector, gradient: Vector) -> float:
    """Return the value at such a state (n,), and fill its gradient (n,)."""
    n = values.ndim
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    gradient[:] = np.nan
    if not locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
        return np.nan
    corners = values.reshape(values.size)
    value = _finite_cell_value(n, corners, offsets, weights)
    if value < np.inf:
        _finite_cell_gradient(n, corners, axes, offsets, weights, value, gradient)
    return value


@inlined
def _locate_block(axis: Vector, coordinates: Vector, size: int, lower: Vector, upper: Vector, weights: Vector) -> None:
    """As `locate` on one axis, for the first `size` coordinates: node offsets, upper weights, NaN outside."""
    # Local variables and branch-free float arithmetic let the compiler vectorise the loop.
    origin, per_unit, lowest, highest = axis[ORIGIN], axis[PER_UNIT], axis[LOWEST], axis[HIGHEST]
    period, per_period = axis[PERIOD], axis[PER_PERIOD]
    last_cell, count, stride = axis[LAST_CELL], axis[COUNT], axis[STRIDE]
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


@inlined
def _locate_blocks(
    n: int, axes: Axes, states: States, first: int, size: int, offsets: Any, weights: Any, coordinates: Vector
) -> None:
    """Fill offsets (n, 2, block) and upper weights (n, block) of the `size` states from `first` on."""
    for k in range(n):
        for i in range(size):
            coordinates[i] = states[first + i, k]
        _locate_block(axes[k], coordinates, size, offsets[k, 0], offsets[k, 1], weights[k])


@inlined
def _gather_block(n: int, corners: Values, size: int, offsets: Any, out: Any) -> None:
    """Fill out (2^n, block) with the corners of each state's cell; bit k of the row selects the node along axis k."""
    for corner in range(1 << n):
        for i in range(size):
            offset = 0
            for k in range(n):
                offset += offsets[k, (corner >> k) & 1, i]
            out[corner, i] = corners[offset]


@inlined
def _mix(rows: int, size: int, weights: Vector, values: Any) -> None:
    """Interpolate along one axis: values[row] between the lower values[row] and the upper values[row + rows]."""
    for row in range(rows):
        for i in range(size):
            values[row, i] = (1.0 - weights[i]) * values[row, i] + weights[i] * values[row + rows, i]


@compiled
def values_at(values: Values, axes: Axes, states: States, out: Vector) -> None:
    """Fill out (N,) with the values at the states (N, n)."""
    # In blocks, so that the processor handles several states per instruction.
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
            if mixed[0, i] - mixed[0, i] != 0.0:  # outside, or next to +inf
                out[first + i] = _value_beside_infinity(values, axes, states[first + i])


@compiled
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
                gradients[first + i, k] = slopes[k, 0, i] * axes[k, PER_UNIT]
                total += slopes[k, 0, i]
            if total - total != 0.0:  # outside, or next to +inf
                out[first + i] = _gradient_beside_infinity(values, axes, states[first + i], gradients[first + i])


@compiled
def value_at(values: Values, axes: Axes, state: Vector) -> float:
    """Return the value at one state (n,); `values` is C-contiguous with n dimensions, `axes` from `axis_table`."""
    # Same arithmetic as `values_at` in the same order, without blocks, which halves the time for one state.
    n = values.ndim
    _check_size(n, state.size)
    offsets, weights = np.empty((n, 2), np.int64), np.empty((n, 2))
    if not locate_cell(n, axes, state.reshape(1, n), 0, offsets, weights):
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


@compiled
def gradient_at(values: Values, axes: Axes, state: Vector, gradient: Vector) -> float:
    """Return the value at one state (n,), and fill its gradient (n,)."""
    out = np.empty(1)
    gradients_at(values, axes, state.reshape(1, state.size), out, gradient.reshape(1, gradient.size))
    return out[0]
