"""Compiled semi-Lagrangian sweep for systems whose f depends on every state: each node has its own steps.

The update is that of `kernels.sweep`. There, all nodes of a row share stencils; here, the stencil of each node is
computed on the fly from its table of 16-bit displacements. Two of three sweeps only try the best step of the last full
sweep (as in policy iteration): that achieves most of what a full sweep would, at a fraction of the cost.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import BLOCKED, FIXED, INTERPOLATE, LOST, NEAR, PASSES_TARGET
from ttr_reward_node.kernels.row_interpolation import Part, Rule, curvature, find_part, place_turn
from ttr_reward_node.kernels.stencil import MOST_AXES, PER_CELL, Floats, Grid, Integers, StepTable
from ttr_reward_node.kernels.sweep import TINY, Nodes, SweepSettings, change_of

_OPTIONS = {"error_model": "numpy"}
_INLINE = {"error_model": "numpy", "forceinline": True}
_CELL_AXES, _MOST_CORNERS = 3, 8  # up to _CELL_AXES axes, interpolate over the cell, above over a simplex
_OFTEN = 4  # most frequent number of axes, with its own specialised code
_BITS = 11  # PER_CELL = 2 ** _BITS, so a shift and a mask split a displacement
_ROUNDED = 3  # rounding error of a step truncated at the edge [1 / PER_CELL cells]
_CELL = np.float32(1.0 / PER_CELL)
_ALL = np.float32(0.99)  # weight of the start node above which a step leads nowhere
_LEAST_PART = 3  # distance to a plane of the grid below which no curvature is added [1 / PER_CELL cells]

CORNERS = np.dtype(
    [
        ("size", np.int64),
        ("own", np.float32),
        ("offset", np.int64, _MOST_CORNERS),
        ("weight", np.float32, _MOST_CORNERS),
        ("lower", np.int64, MOST_AXES),
        ("part", np.int64, MOST_AXES),
        ("between", np.int64),
        ("sorted_part", np.int64, MOST_AXES),
        ("sorted_ahead", np.int64, MOST_AXES),
    ],
    align=True,
)
"""Nodes around the end of one step.

Fields:
    size: Number of corners; 0 where the step leaves the grid.
    own: Weight of the start node, which is excluded from the corners (see `stencil.place_corners`).
    offset, weight: Node and weight of each corner.
    lower: Index of the lower node along each axis.
    part: Distance from the lower node along each axis [1 / PER_CELL cells].
    between: Number of axes along which the end lies between planes of the grid.
    sorted_part, sorted_ahead: Along these axes, `part` in descending order and offset from lower to upper node.
"""

Corners = Any
"""Record of the dtype `CORNERS`."""


@njit(**_OPTIONS)
def sweep_nodes(
    nodes: Nodes,
    grid: Grid,
    steps: StepTable,
    best: NDArray[np.uint16],
    settings: SweepSettings,
    full: bool,
    part: int,
    parts: int,
) -> np.float32:
    """Update every node of a part of the grid.

    Args:
        nodes: All nodes; the values in the part are updated in place.
        grid: Axes, all outer.
        steps: Steps of each node under each pair.
        best: Best pair of each node (nodes,), found by full sweeps and used by the others.
        settings: Settings of the sweep.
        full: Whether all pairs are tried.
        part: Index of the part, from 0: a range of the first axis.
        parts: Number of parts.

    Returns:
        The largest change of phi [s]; infinite if a node became reachable or unreachable.
    """
    n, last = grid.n, grid.counts[grid.n - 1]
    first, until, own = find_part(grid, len(nodes.flags), part, parts)
    rule = Rule(np.float32(settings.jump * settings.rate), np.float32(settings.enough), settings.curved)
    grow = settings.curved or settings.jump == np.inf or not full
    # Unpack outside the loop: Numba counts references whenever it takes an array out of a tuple.
    values, flags, outcomes, row_near = nodes
    codes, ends, long, discounts, controls = steps.codes, steps.ends, steps.long, steps.discounts, steps.controls
    pairs = codes.shape[1]
    index = np.zeros(n, np.int64)
    corners = np.zeros(1, CORNERS)[0]
    simplex = n > _CELL_AXES
    largest = np.float32(0.0)
    down = (settings.bits >> (n - 1)) & 1 == 1
    for turn in range((until - first) * grid.strides[0] // last if n > 1 else 1):
        offset = place_turn(grid, n - 1, turn, first, until, settings.bits, index)
        near = row_near[offset // last + 1] if down else row_near[offset // last] - 1
        for j_turn in range(last):
            node = offset + (last - 1 - j_turn if down else j_turn)
            index[n - 1] = node - offset
            flag = flags[node]
            if flag & FIXED:
                continue
            if flag & NEAR:
                near += -1 if down else 1
            if flag & LOST:
                continue
            new = np.float32(1.0)
            for group in range(0, pairs, controls):
                most = np.float32(0.0)
                begin, end = group, group + controls
                if not full:
                    begin, end = int(best[node]), int(best[node]) + 1
                for p in range(begin, end):
                    code = codes[node, p]
                    outcome = outcomes[near, p] if flag == NEAR else np.float32(INTERPOLATE)
                    if code == 0 or outcome == BLOCKED:
                        continue
                    found = outcome
                    quick = False
                    if simplex and outcome == INTERPOLATE:
                        # With a constant number of axes, the compiler unrolls the loops over them.
                        if n == _OFTEN:
                            quick, found = _go(_OFTEN, values, grid, index, ends, node, p, own, rule, long[p], corners)
                        else:
                            quick, found = _go(n, values, grid, index, ends, node, p, own, rule, long[p], corners)
                        found *= discounts[code]
                    if outcome <= 0.0 and not quick:
                        _place(grid, index, ends, node, p, own, corners)
                        found = np.float32(0.0)
                        if corners.size > 0:
                            past = outcome == PASSES_TARGET
                            discount = discounts[code]
                            if corners.own > 0.0:
                                discount *= (np.float32(1.0) - corners.own) / (np.float32(1.0) - discount * corners.own)
                            found = discount * _interpolate(values, grid, corners, rule, own, long[p], past)
                    if found > most:
                        most = found
                        if full:
                            best[node] = p
                new = min(new, most)
            old = values[node]
            if new < TINY:
                new = np.float32(0.0)
            if new == old or (new < old and grow and new > 0.0) or (not full and new < old):
                continue
            values[node] = new
            largest = max(largest, change_of(old, new, rule.jump))
    return largest / settings.rate


@njit(**_INLINE)
def _lower_node(grid: Grid, k: int, at: int, cells: int) -> tuple[int, int, int]:
    """Return where a step from node `at` ends along axis k: lower node, part of a cell above it, stride to the upper.

    The lower node is -1 if the step leaves the grid; `cells` and the part are in 1 / PER_CELL cells.
    """
    lower, part = at + (cells >> _BITS), cells & (PER_CELL - 1)
    count, ahead = grid.counts[k], grid.strides[k]
    if grid.periodic[k]:
        if lower < 0 or lower >= count:
            lower %= count
        if lower == count - 1:
            ahead = -lower * grid.strides[k]
    else:
        if lower == -1 and part >= PER_CELL - _ROUNDED:
            lower, part = 0, 0
        if lower == count - 1 and part <= _ROUNDED:
            part = 0
        if lower < 0 or lower + (part > 0) >= count:
            lower = -1
    return lower, part, ahead


@njit(**_INLINE)
def _go(
    n: int,
    values: Floats,
    grid: Grid,
    index: Integers,
    ends: NDArray[np.int16],
    node: int,
    p: int,
    own: Part,
    rule: Rule,
    long: bool,
    corners: Corners,
) -> tuple[bool, np.float32]:
    """Interpolate w over a simplex at the end of a step from the node at `index` (n,).

    Returns whether the end lies outside the cells around the node, as it does for most steps, and w there. It combines
    `_place` and `_interpolate` with few branches.
    """
    base, away = np.int64(0), 0
    for k in range(n):
        cells = np.int64(ends[node, p, k])
        away += 1 if cells <= -PER_CELL or cells >= PER_CELL else 0
        lower, part, ahead = _lower_node(grid, k, index[k], cells)
        if lower < 0:
            return True, np.float32(0.0)
        corners.lower[k], corners.part[k] = lower, part
        base += lower * grid.strides[k]
        corners.sorted_ahead[k] = ahead if part > 0 else np.int64(0)
        corners.sorted_part[k] = (part << 3) | k
    if away == 0:
        return False, np.float32(0.0)
    for end in range(n - 1, 0, -1):
        for k in range(end):
            one, other = corners.sorted_part[k], corners.sorted_part[k + 1]
            corners.sorted_part[k], corners.sorted_part[k + 1] = max(one, other), min(one, other)
    before = np.int64(PER_CELL)
    total, reachable, low, high = np.float32(0.0), np.float32(0.0), np.float32(1.0), np.float32(0.0)
    for c in range(n + 1):
        key = corners.sorted_part[c] if c < n else np.int64(0)
        weight = np.float32(before - (key >> 3)) * _CELL
        v = values[_owned(base, own)]
        total += weight * v
        reachable += weight if v > 0.0 else np.float32(0.0)
        low, high = min(low, v), max(high, v)
        before = key >> 3
        base += corners.sorted_ahead[key & 7] if c < n else np.int64(0)
    if rule.jump == np.inf or (low > 0.0 and high - low <= rule.jump * high):
        return True, total + _bend(values, grid, corners, own) if rule.curved else total
    if long or reachable == 0.0 or reachable < rule.enough:
        return True, np.float32(0.0)
    return True, total / reachable


@njit(**_INLINE)
def _place(
    grid: Grid, index: Integers, ends: NDArray[np.int16], node: int, p: int, own: Part, corners: Corners
) -> None:
    """Find the corners around the end of the step from node `index` (n,) under pair p; `ends` has all steps."""
    between, base = 0, np.int64(0)
    corners.size = 0
    for k in range(grid.n):
        lower, part, ahead = _lower_node(grid, k, index[k], np.int64(ends[node, p, k]))
        if lower < 0:
            return
        corners.lower[k], corners.part[k] = lower, part
        base += lower * grid.strides[k]
        if part > 0:
            at = between
            while at > 0 and corners.sorted_part[at - 1] < part:
                corners.sorted_part[at] = corners.sorted_part[at - 1]
                corners.sorted_ahead[at] = corners.sorted_ahead[at - 1]
                at -= 1
            corners.sorted_part[at], corners.sorted_ahead[at] = part, ahead
            between += 1
    corners.between = between
    size = _cell(base, corners) if grid.n <= _CELL_AXES else _simplex(base, corners)
    corners.own = np.float32(0.0)
    for c in range(size):
        if corners.offset[c] == node:
            corners.own = corners.weight[c]
            if corners.own > _ALL:
                return
            size -= 1
            corners.offset[c], corners.weight[c] = corners.offset[size], corners.weight[size]
            break
    if corners.own > 0.0:
        for c in range(size):
            corners.weight[c] /= np.float32(1.0) - corners.own
    for c in range(size):
        if not own.begin <= corners.offset[c] < own.end:
            corners.offset[c] += own.copy
    corners.size = size


@njit(**_INLINE)
def _cell(base: int, corners: Corners) -> int:
    """Fill in the up to 2^n corners of the cell with their multilinear weights, and return their number."""
    size = 1
    corners.offset[0], corners.weight[0] = base, np.float32(1.0)
    for k in range(corners.between):
        upper, ahead = np.float32(corners.sorted_part[k]) * _CELL, corners.sorted_ahead[k]
        for c in range(size):
            corners.offset[size + c], corners.weight[size + c] = corners.offset[c] + ahead, corners.weight[c] * upper
            corners.weight[c] *= np.float32(1.0) - upper
        size *= 2
    return size


@njit(**_INLINE)
def _simplex(base: int, corners: Corners) -> int:
    """Fill in the up to n + 1 corners of the simplex in the cell, and return their number.

    The path over the corners starts at the lowest one and goes up along one axis at a time, in descending order of the
    end's distance.
    """
    before = np.int64(PER_CELL)
    for c in range(corners.between + 1):
        part = corners.sorted_part[c] if c < corners.between else np.int64(0)
        corners.offset[c], corners.weight[c] = base, np.float32(before - part) * _CELL
        before = part
        if c < corners.between:
            base += corners.sorted_ahead[c]
    return corners.between + 1


@njit(**_INLINE)
def _interpolate(
    values: Floats, grid: Grid, corners: Corners, rule: Rule, own: Part, long: bool, past: bool
) -> np.float32:
    """Return w at the end of a step, by the rule of `row_interpolation.interpolate_node`."""
    total, low, high = np.float32(0.0), np.float32(1.0), np.float32(0.0)
    for c in range(corners.size):
        v = values[corners.offset[c]]
        total += corners.weight[c] * v
        low, high = min(low, v), max(high, v)
    if not past and (rule.jump == np.inf or (low > 0.0 and high - low <= rule.jump * high)):
        if rule.curved:
            total += _bend(values, grid, corners, own) / (np.float32(1.0) - corners.own)
        return total
    total, reachable = np.float32(0.0), np.float32(0.0)
    for c in range(corners.size):
        v = values[corners.offset[c]]
        if v > 0.0 and not (past and v == 1.0):
            total += corners.weight[c] * v
            reachable += corners.weight[c]
    if rule.jump == np.inf:
        return total  # the step passes the target, in the first phase
    if long or reachable == 0.0 or (reachable < rule.enough and not past):
        return np.float32(0.0)  # a long step must end where all corners are reachable and smooth
    return total / reachable


@njit(**_OPTIONS)
def _bend(values: Floats, grid: Grid, corners: Corners, own: Part) -> np.float32:
    """Return the curvature omitted by linear interpolation, summed over all axes, at the nearest nodes of the rest."""
    nearest = np.int64(0)
    for k in range(grid.n):
        nearest += (corners.lower[k] + _ahead(grid, corners, k)) * grid.strides[k]
    bend = np.float32(0.0)
    for k in range(grid.n):
        lower, part, count = corners.lower[k], corners.part[k], grid.counts[k]
        outside = not grid.periodic[k] and (lower < 1 or lower + 2 >= count)
        if part < _LEAST_PART or part > PER_CELL - _LEAST_PART or outside:
            continue
        base = nearest - (lower + _ahead(grid, corners, k)) * grid.strides[k]
        v0 = values[_owned(base + (lower - 1) % count * grid.strides[k], own)]
        v1 = values[_owned(base + lower * grid.strides[k], own)]
        v2 = values[_owned(base + (lower + 1) % count * grid.strides[k], own)]
        v3 = values[_owned(base + (lower + 2) % count * grid.strides[k], own)]
        upper = np.float32(part) * _CELL
        bend -= np.float32(0.5) * upper * (np.float32(1.0) - upper) * curvature(v0, v1, v2, v3)
    return bend


@njit(**_INLINE)
def _ahead(grid: Grid, corners: Corners, k: int) -> np.int64:
    """Return the cells from the lower to the nearest node along axis k: 0 or 1, with wrap-around."""
    if 2 * corners.part[k] < PER_CELL:
        return np.int64(0)
    return np.int64(1) if corners.lower[k] + 1 < grid.counts[k] else -corners.lower[k]


@njit(**_INLINE)
def _owned(offset: np.int64, own: Part) -> np.int64:
    """Return where to read a node's value: in place, or in the copy if another thread owns the node."""
    return offset if own.begin <= offset < own.end else offset + own.copy
