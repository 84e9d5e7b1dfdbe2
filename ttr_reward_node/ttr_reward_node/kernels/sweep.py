"""In-place sweep of the semi-Lagrangian scheme over the nodes, compiled once for all systems.

The values are w = exp(-lambda phi), the complement of Kruzhkov's transform v = 1 - w: 1 in the target, exactly 0 where
the target cannot be reached, and equally accurate at large and small times in single precision. The update of a node is

    w(x) = min over d, max over u of exp(-lambda h) w(x(h)),    phi(x) = max over d, min over u of h + phi(x(h)),

the lower value of thesis Eq. 2.18-2.20, in which the control knows the disturbance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import BLOCKED, FIXED, LOST, NEAR, PASSES_TARGET
from ttr_reward_node.kernels.row_interpolation import (
    STENCIL,
    RowRule,
    find_part,
    interpolate_node,
    interpolate_row,
    place_row,
    place_turn,
)
from ttr_reward_node.kernels.stencil import (
    OFFSETS,
    Floats,
    Grid,
    Integers,
    Offsets,
    SlabOffsets,
    StepTable,
    place_corners,
    place_curves,
)

_OPTIONS = {"error_model": "numpy"}
_INLINE = {"error_model": "numpy", "forceinline": True}
TINY = np.float32(1e-30)  # smaller values count as unreachable, and avoid slow denormal arithmetic


class Nodes(NamedTuple):
    """All nodes of the grid, flat, in the layout's order.

    Attributes:
        values: w at the nodes (nodes,), updated by the sweep; with two parts, followed by a copy from before the sweep.
        flags: FREE, NEAR or FIXED at the nodes (nodes,).
        outcomes: Outcome of each pair's step from the near nodes (near nodes, pairs), from `find_outcomes`.
        row_near: Number of near nodes before each row (rows + 1,).
    """

    values: Floats
    flags: NDArray[np.uint8]
    outcomes: Floats
    row_near: Integers


class RowHistory(NamedTuple):
    """Times of the rows' updates and changes: a row is updated again only if a row in its stencils has changed.

    Attributes:
        changed: Last change of each row (rows,), in ticks of its part's clock.
        seen: Last update of each row (rows,), in ticks of its part's clock; 0 for none.
        clocks: Number of updates and changes so far in each part (parts,).
        changed_in: Last sweep in which each row changed (rows,); with two parts, followed by a copy from before the
            sweep.
    """

    changed: Integers
    seen: Integers
    clocks: Integers
    changed_in: Integers


class SweepSettings(NamedTuple):
    """Settings of one sweep in a phase of the solver.

    Attributes:
        rate: Rate lambda of the transform [1/s].
        jump: Difference of phi across a cell above which it counts as a jump, without curvature [s]. Infinite:
            unreachable corners count as w = 0.
        enough: Minimum total weight of the reachable corners for a step to count.
        quiet: Largest change of phi that does not trigger updates of the rows that read this one [s].
        curved: Whether the curvature is added.
        number: Number of this sweep, from 1.
        bits: Sweep direction: axis k is traversed downwards if bit k is set, unless the motion along it determines the
            direction.
    """

    rate: float
    jump: float
    enough: float
    quiet: float
    curved: bool
    number: int
    bits: int


class _Row(NamedTuple):
    """One row to update.

    Attributes:
        offset: Index of its first node.
        near: Index of the near node before the first one in the row.
        down: Whether the row is traversed from its last node to its first.
    """

    offset: int
    near: int
    down: bool


class _Game(NamedTuple):
    """Rule that combines the values of the pairs into the new value of a node.

    Attributes:
        controls: Number of controls; the control is the fastest-varying index of the pairs.
        grow: Whether w never decreases, except to 0.
    """

    controls: int
    grow: bool


class _Workspace(NamedTuple):
    """Tables and buffers of one row, allocated once per sweep.

    Attributes:
        stencils: Stencils of the row (pairs,), records of the dtype `STENCIL`.
        buffers: Scratch rows (3, count).
        found: Discounted w at the end of each step (pairs, count).
        own: Pairs whose steps end on the row itself (pairs,).
    """

    stencils: NDArray[Any]
    buffers: Floats
    found: Floats
    own: Integers


@njit(**_OPTIONS)
def sweep(
    nodes: Nodes, grid: Grid, steps: StepTable, history: RowHistory, settings: SweepSettings, part: int, parts: int
) -> tuple[np.float32, int]:
    """Update every row of a part (nodes along the last axis) with a changed row in its stencils.

    Args:
        nodes: All nodes; the values in the part are updated in place.
        grid: Axes in the layout's order.
        steps: Steps of each slab under each pair.
        history: Times of the rows' updates and changes, updated in place.
        settings: Settings of the sweep.
        part: Index of the part, from 0: a range of the first axis.
        parts: Number of parts.

    Returns:
        The largest change of phi [s], infinite if a node became reachable or unreachable; and the number of updated
        rows.
    """
    n, last, bits = grid.n, grid.counts[grid.n - 1], settings.bits
    slabs, pairs = steps.codes.shape
    all_rows = len(history.seen)
    inner_size = all_rows * last // slabs
    index, down = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    corners, curves = np.zeros(pairs, OFFSETS), np.zeros(pairs, OFFSETS)
    slab_offsets = SlabOffsets(corners, curves)
    rows = np.zeros(pairs * ((1 << n) + 2 * n), np.int64)
    stencils = np.zeros(pairs, STENCIL)
    for p in range(pairs):
        stencils[p].long = steps.long[p]
    buffers, found = np.zeros((3, last), np.float32), np.zeros((pairs, last), np.float32)
    work = _Workspace(stencils, buffers, found, np.zeros(pairs, np.int64))
    quiet = np.float32(settings.quiet * settings.rate)
    rule = RowRule(
        np.float32(settings.jump * settings.rate), np.float32(settings.enough), grid.periodic[n - 1] == 1, last
    )
    game = _Game(steps.controls, settings.curved or settings.jump == np.inf)
    row_near = nodes.row_near
    changed, seen, clocks, changed_in = history
    first, until, own = find_part(grid, all_rows * last, part, parts)
    per_first = slabs if grid.n_outer == 0 else slabs // grid.counts[0]
    largest, done = np.float32(0.0), 0
    for turn in range(per_first if grid.n_outer == 0 else per_first * (until - first)):
        slab_offset = place_turn(grid, grid.n_outer, turn, first, until, bits, index)
        slab = slab_offset // inner_size
        for p in range(pairs):
            corners[p].number, curves[p].number = 0, 0
            if steps.codes[slab, p] > 0:
                place_corners(grid, index, steps.ends[slab, p], corners[p])
                own_weight, discount = corners[p].own, steps.discounts[steps.codes[slab, p]]
                stencils[p].discount = discount * (1.0 - own_weight) / (1.0 - discount * own_weight)
                if settings.curved and corners[p].number > 0:
                    place_curves(grid, index, steps.ends[slab, p], curves[p])
                    for q in range(curves[p].number):
                        curves[p].weight[q] /= np.float32(1.0) - own_weight
        _directions(grid, steps.ends[slab], corners, bits, down)
        for row_turn in range(inner_size // last):
            rest, offset = row_turn, slab_offset
            for k in range(n - 2, grid.n_outer - 1, -1):
                i = rest % grid.counts[k]
                rest //= grid.counts[k]
                index[k] = grid.counts[k] - 1 - i if down[k] else i
                offset += index[k] * grid.strides[k]
            n_rows = place_row(grid, index, own, offset, slab_offsets, steps.ranges[slab], stencils, rows)
            here = offset // last
            fresh = seen[here] == 0
            for i in range(n_rows):
                row = rows[i] // last
                if row < all_rows:
                    fresh |= changed[row] > seen[here]
                else:  # a copy: changes of the previous sweep are new here
                    fresh |= changed_in[row] == settings.number - 1
            if not fresh:
                continue
            done += 1
            clocks[part] += 1
            seen[here] = clocks[part]
            near = row_near[here + 1] if down[n - 1] else row_near[here] - 1
            change = _update_row(nodes, _Row(offset, near, down[n - 1]), work, rule, game)
            largest = max(largest, change)
            if change > quiet:
                clocks[part] += 1  # later than `seen`, so that a row that reads itself is updated again
                changed[here] = clocks[part]
                changed_in[here] = settings.number
    return largest / settings.rate, done


@njit(**_OPTIONS)
def _directions(grid: Grid, ends: NDArray[np.int16], corners: Offsets, bits: int, down: NDArray[np.bool_]) -> None:
    """Set the direction along each inner axis against the motion, so that a node follows those that it depends on."""
    for k in range(grid.n_outer, grid.n):
        ahead, way = np.float32(0.0), np.float32(0.0)
        for p in range(len(ends)):
            if corners[p].number > 0:
                ahead += np.float32(ends[p, k])
                way += abs(np.float32(ends[p, k]))
        down[k] = ahead > 0.0 if abs(ahead) > 0.5 * way else ((bits >> k) & 1) == 1


@njit(**_OPTIONS)
def _update_row(nodes: Nodes, row: _Row, work: _Workspace, rule: RowRule, game: _Game) -> np.float32:
    """Update the nodes of a row and return the largest relative change."""
    values, flags, _, _ = nodes
    stencils, buffers, found, own = work
    offset, near, down = row
    pairs, last = found.shape
    # Steps along the row use its new values. A game needs all pairs at once, which takes longer.
    n_own = 0
    for p in range(pairs):
        if stencils[p].size == 0:
            found[p, :] = 0.0
        elif stencils[p].on_own_row == 1 and pairs == game.controls:
            found[p, :] = 0.0
            own[n_own] = p
            n_own += 1
        else:
            interpolate_row(values, stencils[p], rule, buffers, found[p])
    news = buffers[0]
    _min_max_row(found, game.controls, news, buffers[1])
    largest = np.float32(0.0)
    step = -1 if down else 1
    for turn in range(last):
        j = last - 1 - turn if down else turn
        flag = flags[offset + j]
        if flag & NEAR:
            near += step
        if flag & (FIXED | LOST):
            continue
        new = news[j]
        for i in range(n_own):
            stencil = stencils[own[i]]
            found[own[i], j] = stencil.discount * interpolate_node(values, stencil, rule, j, False)
            new = max(new, found[own[i], j])
        if flag & NEAR:
            new = _near_value(nodes, work, near, j, rule, game.controls)
        if new < TINY:
            new = np.float32(0.0)
        elif game.grow and new < values[offset + j]:
            continue
        old = values[offset + j]
        if new != old:
            values[offset + j] = new
            largest = max(largest, change_of(old, new, rule.jump))
    return largest


@njit(**_INLINE)
def change_of(old: np.float32, new: np.float32, jump: np.float32) -> np.float32:
    """Return the change of a node's phi times the rate; infinite if the node becomes reachable or unreachable.

    In the first phase (`jump` infinite) it is the change of w itself, since only large w matter there.
    """
    if jump == np.inf:
        return abs(new - old)
    return abs(new - old) / max(new, old) if min(new, old) > 0.0 else np.float32(np.inf)


@njit(**_OPTIONS)
def _min_max_row(found: Floats, controls: int, news: Floats, best: Floats) -> None:
    """Fill `news` with the minimum over disturbances of the maximum over controls, along a row."""
    pairs, last = found.shape
    news[:] = 1.0
    for first in range(0, pairs, controls):
        best[:] = 0.0
        for p in range(first, first + controls):
            line = found[p]
            for j in range(last):
                best[j] = line[j] if line[j] > best[j] else best[j]
        for j in range(last):
            news[j] = best[j] if best[j] < news[j] else news[j]


@njit(**_OPTIONS)
def _near_value(nodes: Nodes, work: _Workspace, near: int, j: int, rule: RowRule, controls: int) -> np.float32:
    """Return the new value of node j of the row, which is near node number `near`."""
    values, outcomes = nodes.values, nodes.outcomes
    stencils, found = work.stencils, work.found
    worst = np.float32(1.0)
    for first in range(0, len(found), controls):
        best = np.float32(0.0)
        for p in range(first, first + controls):
            outcome = outcomes[near, p]
            if outcome > 0.0:
                best = max(best, outcome)
            elif outcome == PASSES_TARGET and stencils[p].size > 0:
                w = interpolate_node(values, stencils[p], rule, j, True)
                best = max(best, stencils[p].discount * w)
            elif outcome != BLOCKED:
                best = max(best, found[p, j])
        worst = min(worst, best)
    return worst
