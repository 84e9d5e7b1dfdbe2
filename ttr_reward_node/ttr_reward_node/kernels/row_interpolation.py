"""Compiled interpolation at the ends of the steps from one row, i.e. the nodes along the last axis.

Interpolation is linear with two exceptions. In a cell with unreachable corners only the reachable ones count, if they
weigh enough (similar to `ctrl_rl_core.values.interpolation`), so that no value is invented at the edge of the reachable
set. Where w is smooth, the curvature omitted by linear interpolation is added: the smaller of the two neighbouring
second differences, as in ENO schemes, and none if their signs differ.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.stencil import MOST_CORNERS, Floats, Grid, Integers, Offsets, SlabOffsets

_MOST_CURVES = 6
STENCIL = np.dtype(
    [
        ("size", np.int64),
        ("begin", np.int64),
        ("end", np.int64),
        ("on_own_row", np.int64),
        ("long", np.int64),
        ("curves", np.int64),
        ("corner", np.int64, MOST_CORNERS),
        ("corner_shift", np.int64, MOST_CORNERS),
        ("curve_begin", np.int64, _MOST_CURVES),
        ("curve_end", np.int64, _MOST_CURVES),
        ("curve_node", np.int64, (_MOST_CURVES, 4)),
        ("corner_weight", np.float32, MOST_CORNERS),
        ("curve_weight", np.float32, _MOST_CURVES),
        ("discount", np.float32),
    ],
    align=True,
)
"""Stencil of the nodes j of a row under one pair.

Fields:
    size: Number of corners; 0 if the step leaves the grid.
    begin, end: Range of j for which all corners lie within their rows.
    on_own_row: 1 if more than half of the weight lies on this row itself, else 0.
    long: 1 for a long step, which counts only if all corners are reachable without a jump between them, else 0.
    curves: Number of curves.
    corner: Corner c is node corner[c] + j.
    corner_shift: Cells from the start to each corner along the row.
    curve_begin, curve_end: Range of j in which each curve is used.
    curve_node: Four nodes of each curve, minus j.
    corner_weight, curve_weight: Weights of corners and curves.
    discount: exp(-lambda h) of the step.
"""

Stencil = Any
"""Record of the dtype `STENCIL`."""
_OPTIONS = {"error_model": "numpy"}
_INLINE = {"error_model": "numpy", "forceinline": True}


class RowRule(NamedTuple):
    """Interpolation settings for the rows of one sweep.

    Attributes:
        jump: Largest relative difference of w across a cell attributed to a slope; infinite: unreachable corners count
            as w = 0.
        enough: Minimum total weight of the reachable corners.
        periodic: Whether the rows are periodic.
        length: Number of nodes in a row.
    """

    jump: np.float32
    enough: np.float32
    periodic: bool
    length: int


class Rule(NamedTuple):
    """Interpolation settings for one sweep over single nodes or slabs.

    Attributes:
        jump: Largest relative difference of w across a cell attributed to a slope; infinite: unreachable corners count
            as w = 0.
        enough: Minimum total weight of the reachable corners.
        curved: Whether the curvature is added.
    """

    jump: np.float32
    enough: np.float32
    curved: bool


class Part(NamedTuple):
    """Part of the grid swept by one thread. Values of other parts are read from a copy made before the sweep.

    Attributes:
        begin, end: Range of its nodes.
        copy: Offset from a node's value to its copy from before the sweep.
    """

    begin: int
    end: int
    copy: int


@njit(**_INLINE)
def find_part(grid: Grid, nodes: int, part: int, parts: int) -> tuple[int, int, Part]:
    """Return the range of part `part` of `parts` along the first axis, and the part of all `nodes` nodes."""
    first, until = part * grid.counts[0] // parts, (part + 1) * grid.counts[0] // parts
    if parts == 1:
        return first, until, Part(0, nodes, 0)
    return first, until, Part(first * grid.strides[0], until * grid.strides[0], nodes)


@njit(**_INLINE)
def place_turn(grid: Grid, axes: int, turn: int, first: int, until: int, bits: int, index: Integers) -> int:
    """Write the position of turn `turn` of the sweep into `index` along the first `axes` axes; return the node offset.

    The first axis is traversed from `first` to `until`; axis k is traversed downwards if bit k of `bits` is set.
    """
    rest, offset = turn, 0
    for k in range(axes - 1, -1, -1):
        low, high = (first, until) if k == 0 else (0, grid.counts[k])
        i = rest % (high - low)
        rest //= high - low
        index[k] = high - 1 - i if (bits >> k) & 1 else low + i
        offset += index[k] * grid.strides[k]
    return offset


@njit(**_OPTIONS)
def place_row(
    grid: Grid,
    index: Integers,
    part: Part,
    offset: int,
    slab: SlabOffsets,
    ranges: NDArray[np.int8],
    stencils: NDArray[Any],
    rows: Integers,
) -> int:
    """Fill in the stencils (pairs,) of the row at `index` (n,), whose first node has offset `offset`.

    Also fills `rows` with the offsets of the rows that the stencils read, possibly repeated, and returns their number.
    """
    all_corners, all_curves = slab
    last, along = grid.counts[grid.n - 1], grid.n - grid.n_outer - 1
    n_rows = 0
    for p in range(all_corners.size):
        stencil, corners = stencils[p], all_corners[p]
        stencil.size, stencil.curves, stencil.on_own_row = corners.number, 0, 0
        begin, end = _range_of_starts(grid, index, ranges[p], stencil)
        own = np.float32(0.0)
        for c in range(stencil.size):
            at = _row_of(grid, index, part, corners, c)
            if at < 0:
                stencil.size = 0
                break
            s = corners.shift[c, along]
            stencil.corner[c], stencil.corner_shift[c], stencil.corner_weight[c] = at + s, s, corners.weight[c]
            begin, end = max(begin, -s), min(end, last - s)
            own += corners.weight[c] if at == offset else np.float32(0.0)
            if c == 0 or rows[n_rows - 1] != at:
                rows[n_rows] = at
                n_rows += 1
        stencil.on_own_row = own > 0.5
        stencil.begin, stencil.end = begin, max(begin, end)
        if stencil.size == 0:
            continue
        curves = all_curves[p]
        for q in range(curves.number):
            used = stencil.curves
            begin, end, fits = stencil.begin, stencil.end, True
            for i in range(4):
                at = _row_of(grid, index, part, curves, 4 * q + i)
                if at < 0:
                    fits = False
                    break
                s = curves.shift[4 * q + i, along]
                stencil.curve_node[used, i] = at + s
                begin, end = max(begin, -s), min(end, last - s)
                if i == 0 or i == 3:
                    rows[n_rows] = at
                    n_rows += 1
            if fits:
                stencil.curve_begin[used], stencil.curve_end[used] = begin, end
                stencil.curve_weight[used] = curves.weight[q]
                stencil.curves = used + 1
    return n_rows


@njit(**_OPTIONS)
def _range_of_starts(
    grid: Grid, index: Integers, ranges: NDArray[np.int8], stencil: Stencil
) -> tuple[np.int64, np.int64]:
    """Return the range of nodes along the last axis whose steps stay on the grid; set size 0 if there are none."""
    begin, end = np.int64(0), grid.counts[grid.n - 1]
    for k in range(grid.n_outer, grid.n):
        low, high = np.int64(ranges[k - grid.n_outer, 0]), np.int64(ranges[k - grid.n_outer, 1])
        if grid.periodic[k]:
            continue
        if k == grid.n - 1:
            begin, end = max(begin, -low), min(end, grid.counts[k] - high)
        elif index[k] + low < 0 or index[k] + high >= grid.counts[k]:
            stencil.size = 0
    return begin, end


@njit(**_OPTIONS)
def interpolate_row(values: Floats, stencil: Stencil, rule: RowRule, buffers: Floats, out: Floats) -> None:
    """Fill `out` (count,) with the discounted w at the end of each step from a row; `buffers` (3, count) is scratch.

    Loops over j are kept simple so that the compiler vectorises them.
    """
    begin, end, discount, jump = stencil.begin, stencil.end, stencil.discount, rule.jump
    m = end - begin
    total, low, high, result = buffers[0, :m], buffers[1, :m], buffers[2, :m], out[begin:end]
    out[:begin] = 0.0
    out[end:] = 0.0
    if jump == np.inf:
        total[:] = 0.0
        for c in range(stencil.size):
            at, weight = stencil.corner[c] + begin, stencil.corner_weight[c]
            line = values[at : at + m]
            for j in range(m):
                total[j] += weight * line[j]
        for j in range(m):
            result[j] = discount * total[j]
        _fill_periodic(values, stencil, rule, out)
        return
    for c in range(stencil.size):
        at, weight = stencil.corner[c] + begin, stencil.corner_weight[c]
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
    for q in range(stencil.curves):
        weight = stencil.curve_weight[q]
        start, size = stencil.curve_begin[q], stencil.curve_end[q] - stencil.curve_begin[q]
        if size > 0:
            smooth = total[start - begin : start - begin + size]
            at0, at1 = stencil.curve_node[q, 0] + start, stencil.curve_node[q, 1] + start
            at2, at3 = stencil.curve_node[q, 2] + start, stencil.curve_node[q, 3] + start
            line0, line1 = values[at0 : at0 + size], values[at1 : at1 + size]
            line2, line3 = values[at2 : at2 + size], values[at3 : at3 + size]
            for j in range(size):
                smooth[j] += weight * curvature(line0[j], line1[j], line2[j], line3[j])
    odd = 0
    instead = np.float32(0.0) if stencil.long else np.float32(-1.0)
    for j in range(m):
        jumps = high[j] - low[j] > jump * high[j]
        odd += 1 if jumps else 0
        result[j] = instead if jumps else discount * total[j]
    if odd > 0 and not stencil.long:
        for j in range(begin, end):
            if out[j] < 0.0:
                out[j] = discount * interpolate_node(values, stencil, rule, j, False)
    _fill_periodic(values, stencil, rule, out)


@njit(**_OPTIONS)
def _fill_periodic(values: Floats, stencil: Stencil, rule: RowRule, out: Floats) -> None:
    """Fill in the nodes of a periodic row whose steps cross the row's ends."""
    if rule.periodic:
        for j in range(rule.length):
            if j < stencil.begin or j >= stencil.end:
                out[j] = stencil.discount * interpolate_node(values, stencil, rule, j, False)


@njit(**_INLINE)
def curvature(v0: float, v1: float, v2: float, v3: float) -> np.float32:
    """Return the second difference between the middle two of four nodes; 0 if ambiguous or a node is unreachable."""
    a, b = v0 - v1 - v1 + v2, v1 - v2 - v2 + v3
    smaller = a if abs(a) < abs(b) else b
    return np.float32(smaller if a * b > 0.0 and v0 > 0.0 and v3 > 0.0 else 0.0)


@njit(**_INLINE)
def interpolate_node(values: Floats, stencil: Stencil, rule: RowRule, j: int, past: bool) -> np.float32:
    """Return w at the end of the step from node j of a row; 0 if the end is unreachable or off the grid.

    `past`: the step passes the target, whose nodes (the only ones with w = 1) are ignored.
    """
    if (j < stencil.begin or j >= stencil.end) and not rule.periodic:
        return np.float32(0.0)
    total, reachable, low, high = np.float32(0.0), np.float32(0.0), np.float32(1.0), np.float32(0.0)
    for c in range(stencil.size):
        v = _corner(values, stencil, rule, c, j)
        if v > 0.0 and not (past and v == 1.0):
            total += stencil.corner_weight[c] * v
            reachable += stencil.corner_weight[c]
            low, high = min(low, v), max(high, v)
    if rule.jump == np.inf:
        return total
    jumps = high - low > rule.jump * high
    if stencil.long and (jumps or reachable < 0.9999):
        return np.float32(0.0)
    if reachable == 0.0 or (reachable < rule.enough and not past):
        return np.float32(0.0)
    if jumps or reachable < 0.9999:
        return total / reachable
    for q in range(stencil.curves):
        if stencil.curve_begin[q] <= j < stencil.curve_end[q]:
            at0, at1 = stencil.curve_node[q, 0] + j, stencil.curve_node[q, 1] + j
            at2, at3 = stencil.curve_node[q, 2] + j, stencil.curve_node[q, 3] + j
            total += stencil.curve_weight[q] * curvature(values[at0], values[at1], values[at2], values[at3])
    return total


@njit(**_INLINE)
def _corner(values: Floats, stencil: Stencil, rule: RowRule, c: int, j: int) -> np.float32:
    if rule.periodic:
        s = stencil.corner_shift[c]
        return values[stencil.corner[c] - s + (j + s) % rule.length]
    return values[stencil.corner[c] + j]


@njit(**_INLINE)
def _row_of(grid: Grid, index: Integers, part: Part, offsets: Offsets, c: int) -> int:
    """Return the offset of the row of node c, or of its copy if another thread owns it; -1 off the grid."""
    at = offsets.outer[c]
    for k in range(grid.n_outer, grid.n - 1):
        i = index[k] + offsets.shift[c, k - grid.n_outer]
        if grid.periodic[k]:
            i = i % grid.counts[k]
        elif i < 0 or i >= grid.counts[k]:
            return -1
        at += i * grid.strides[k]
    return at if part.begin <= at < part.end else at + part.copy
