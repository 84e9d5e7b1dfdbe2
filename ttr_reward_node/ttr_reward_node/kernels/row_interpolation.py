"""Interpolation where the steps from one row end; a row is the nodes along the last axis. Compiled.

Linear interpolation, with two exceptions. In a cell with unreachable corners the others count alone, if they weigh
enough (much as in `ctrl_rl_core.values.interpolation`), so that no number is made up at the edge of what can be
reached. Where all is smooth, the curvature is added that linear interpolation leaves out: the smaller of the two
neighbouring second differences, as in ENO schemes, and none where they differ in sign.

What the nodes j of a row look at is kept in two tables, one line a pair. `plan` (integers): number of corners; the
range of j for which all of them lie within their rows; whether one lies in this very row; number of curves; then BASE +
c, so that corner c is node plan[p, BASE + c] + j, and SHIFT + c, how far along the row that is; then for each curve its
range of j and four nodes. `weights`: of corners and curves, and the discount exp(-lambda h). (Tables, because Numba
counts references for every array that it takes out of a tuple, which costs more than the arithmetic.)
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.stencil import Corners, Curves, Grid

_MOST_CORNERS, _MOST_CURVES = 64, 6
SIZE, BEGIN, END, OWN, CURVES, BASE = range(6)
SHIFT = BASE + _MOST_CORNERS
CURVE = SHIFT + _MOST_CORNERS
PLAN = CURVE + 6 * _MOST_CURVES
CURVE_WEIGHT = _MOST_CORNERS
DISCOUNT = CURVE_WEIGHT + _MOST_CURVES
WEIGHTS = DISCOUNT + 1
"""Columns of the tables, and how many there are."""

_OPTIONS = {"error_model": "numpy"}
_INLINE = {"error_model": "numpy", "forceinline": True}
_ENOUGH = 0.75  # weight of the corners that must be reachable; errors add up over the steps, so half is too little
Floats = NDArray[np.float32]
Integers = NDArray[np.int64]


@njit(**_OPTIONS)
def place_row(
    grid: Grid,
    index: Integers,
    offset: int,
    corners: Corners,
    curves: Curves,
    plan: Integers,
    weights: Floats,
    rows: Integers,
) -> int:
    """Fill in the tables for the row at `index` (n,), whose first node has that offset.

    Fills rows with the offsets of the rows that it looks at, some of them more than once, and returns their number.
    """
    counts, periodic, strides, n_outer = grid
    number, outer, shift, weight = corners
    curve_number, curve_outer, curve_shift, curve_weight = curves
    last, along = counts[-1], counts.size - n_outer - 1
    n_rows = 0
    for p in range(number.size):
        plan[p, SIZE], plan[p, CURVES], plan[p, OWN] = number[p], 0, 0
        plan[p, BEGIN], plan[p, END] = 0, last
        own = np.float32(0.0)
        for c in range(number[p]):
            at = _row_of(counts, periodic, strides, n_outer, index, outer[p, c], shift, p, c)
            if at < 0:
                plan[p, SIZE] = 0
                break
            s = shift[p, c, along]
            plan[p, BASE + c], plan[p, SHIFT + c], weights[p, c] = at + s, s, weight[p, c]
            plan[p, BEGIN], plan[p, END] = max(plan[p, BEGIN], -s), min(plan[p, END], last - s)
            own += weight[p, c] if at == offset else np.float32(0.0)
            if c == 0 or rows[n_rows - 1] != at:
                rows[n_rows] = at
                n_rows += 1
        plan[p, OWN] = own > 0.5
        plan[p, END] = max(plan[p, BEGIN], plan[p, END])
        if plan[p, SIZE] == 0:
            continue
        for q in range(curve_number[p]):
            first = CURVE + 6 * plan[p, CURVES]
            begin, end, fits = plan[p, BEGIN], plan[p, END], True
            for i in range(4):
                at = _row_of(
                    counts, periodic, strides, n_outer, index, curve_outer[p, 4 * q + i], curve_shift, p, 4 * q + i
                )
                if at < 0:
                    fits = False
                    break
                s = curve_shift[p, 4 * q + i, along]
                plan[p, first + 2 + i] = at + s
                begin, end = max(begin, -s), min(end, last - s)
                if i == 0 or i == 3:
                    rows[n_rows] = at
                    n_rows += 1
            if fits:
                plan[p, first], plan[p, first + 1] = begin, end
                weights[p, CURVE_WEIGHT + plan[p, CURVES]] = curve_weight[p, q]
                plan[p, CURVES] += 1
    return n_rows


@njit(**_OPTIONS)
def interpolate_row(
    values: Floats, plan: Integers, weights: Floats, p: int, jump: float, periodic: bool, buffers: Floats, out: Floats
) -> None:
    """Fill out[p] with what pair p gives the nodes of a row: its discount times w where its step ends.

    Loops over j are kept plain: they become vector code.
    """
    begin, end, discount, last = plan[p, BEGIN], plan[p, END], weights[p, DISCOUNT], out.shape[1]
    m = end - begin
    total, low, high, result = buffers[0, :m], buffers[1, :m], buffers[2, :m], out[p, begin:end]
    out[p, :begin] = 0.0
    out[p, end:] = 0.0
    if jump == np.inf:
        total[:] = 0.0
        for c in range(plan[p, SIZE]):
            at, weight = plan[p, BASE + c] + begin, weights[p, c]
            line = values[at : at + m]
            for j in range(m):
                total[j] += weight * line[j]
        for j in range(m):
            result[j] = discount * total[j]
        _fill_round(values, plan, weights, p, jump, periodic, out)
        return
    for c in range(plan[p, SIZE]):
        at, weight = plan[p, BASE + c] + begin, weights[p, c]
        line = values[at : at + m]
        if c == 0:
            for j in range(m):
                v = line[j]
                total[j] = weight * v
                low[j] = v
                high[j] = v
        else:
            for j in range(m):
                v = line[j]
                total[j] += weight * v
                low[j] = v if v < low[j] else low[j]
                high[j] = v if v > high[j] else high[j]
    for q in range(plan[p, CURVES]):
        first, weight = CURVE + 6 * q, weights[p, CURVE_WEIGHT + q]
        start, size = plan[p, first], plan[p, first + 1] - plan[p, first]
        if size > 0:
            smooth = total[start - begin : start - begin + size]
            at0, at1, at2, at3 = plan[p, first + 2], plan[p, first + 3], plan[p, first + 4], plan[p, first + 5]
            line0, line1 = values[at0 + start : at0 + start + size], values[at1 + start : at1 + start + size]
            line2, line3 = values[at2 + start : at2 + start + size], values[at3 + start : at3 + start + size]
            for j in range(size):
                smooth[j] += weight * _curvature(line0[j], line1[j], line2[j], line3[j])
    odd = 0
    for j in range(m):
        jumps = high[j] - low[j] > jump * high[j]
        odd += 1 if jumps else 0
        result[j] = np.float32(-1.0) if jumps else discount * total[j]
    if odd > 0:
        for j in range(begin, end):
            if out[p, j] < 0.0:
                out[p, j] = discount * interpolate_node(values, plan, weights, p, j, jump, periodic, last, False)
    _fill_round(values, plan, weights, p, jump, periodic, out)


@njit(**_OPTIONS)
def _fill_round(
    values: Floats, plan: Integers, weights: Floats, p: int, jump: float, periodic: bool, out: Floats
) -> None:
    """Fill in the nodes of a periodic row from which the step goes round."""
    last = out.shape[1]
    if periodic:
        for j in range(last):
            if j < plan[p, BEGIN] or j >= plan[p, END]:
                w = interpolate_node(values, plan, weights, p, j, jump, periodic, last, False)
                out[p, j] = weights[p, DISCOUNT] * w


@njit(**_INLINE)
def _curvature(v0: float, v1: float, v2: float, v3: float) -> np.float32:
    """Second difference between the middle two of four nodes, 0 where it is not clear or a node is unreachable."""
    a, b = v0 - v1 - v1 + v2, v1 - v2 - v2 + v3
    smaller = a if abs(a) < abs(b) else b
    return np.float32(smaller if a * b > 0.0 and v0 > 0.0 and v3 > 0.0 else 0.0)


@njit(**_INLINE)
def interpolate_node(
    values: Floats, plan: Integers, weights: Floats, p: int, j: int, jump: float, periodic: bool, last: int, past: bool
) -> np.float32:
    """W where pair p's step from one node j ends; 0 if that is unreachable or outside.

    `past`: the step passes by the target; its nodes, the only ones with w = 1, do not count.
    """
    if (j < plan[p, BEGIN] or j >= plan[p, END]) and not periodic:
        return np.float32(0.0)
    total, reachable, low, high = np.float32(0.0), np.float32(0.0), np.float32(1.0), np.float32(0.0)
    for c in range(plan[p, SIZE]):
        v = _corner(values, plan, p, c, j, periodic, last)
        if v > 0.0 and not (past and v == 1.0):
            total += weights[p, c] * v
            reachable += weights[p, c]
            low, high = min(low, v), max(high, v)
    if jump == np.inf:
        return total
    if reachable == 0.0 or (reachable < _ENOUGH and not past):
        return np.float32(0.0)
    if high - low > jump * high:
        middle = np.float32(0.5) * (high + low)
        upper, upper_weight = np.float32(0.0), np.float32(0.0)
        for c in range(plan[p, SIZE]):
            v = _corner(values, plan, p, c, j, periodic, last)
            if v > middle and not (past and v == 1.0):
                upper += weights[p, c] * v
                upper_weight += weights[p, c]
        if upper_weight + upper_weight >= reachable:
            return upper / upper_weight
        return (total - upper) / (reachable - upper_weight)
    if reachable < 0.9999:
        return total / reachable
    for q in range(plan[p, CURVES]):
        first = CURVE + 6 * q
        if plan[p, first] <= j < plan[p, first + 1]:
            at0, at1, at2, at3 = plan[p, first + 2], plan[p, first + 3], plan[p, first + 4], plan[p, first + 5]
            curvature = _curvature(values[at0 + j], values[at1 + j], values[at2 + j], values[at3 + j])
            total += weights[p, CURVE_WEIGHT + q] * curvature
    return total


@njit(**_INLINE)
def _corner(values: Floats, plan: Integers, p: int, c: int, j: int, periodic: bool, last: int) -> np.float32:
    if periodic:
        s = plan[p, SHIFT + c]
        return values[plan[p, BASE + c] - s + (j + s) % last]
    return values[plan[p, BASE + c] + j]


@njit(**_INLINE)
def _row_of(
    counts: Integers, periodic: NDArray[np.bool_], strides: Integers, n_outer: int, index: Integers, outer: int,
    shift: Integers, p: int, c: int,
) -> int:  # fmt: skip
    """Offset of the row that a corner lies in; -1 outside the grid."""
    at = outer
    for k in range(n_outer, counts.size - 1):
        i = index[k] + shift[p, c, k - n_outer]
        if periodic[k]:
            i = i % counts[k]
        elif i < 0 or i >= counts[k]:
            return -1
        at += i * strides[k]
    return at
