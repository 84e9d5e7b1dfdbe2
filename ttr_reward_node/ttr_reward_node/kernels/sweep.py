"""One sweep of the semi-Lagrangian scheme over the nodes, in place, compiled once for all systems.

The values are w = exp(-lambda phi), which is Kruzhkov's transform v = 1 - w seen from the other end: 1 in the target,
exactly 0 where nothing leads to it, and in single precision as exact at large times as at small ones. A node becomes

    w(x) = min over d, max over u of exp(-lambda h) w(x(h)),    phi(x) = max over d, min over u of h + phi(x(h)),

the lower value of thesis Eq. 2.18-2.20, in which the control knows the disturbance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import BLOCKED, FIXED, NEAR, PASSES_TARGET
from ttr_reward_node.kernels.row_interpolation import (
    DISCOUNT,
    OWN,
    PLAN,
    SIZE,
    WEIGHTS,
    interpolate_node,
    interpolate_row,
    place_row,
)
from ttr_reward_node.kernels.stencil import Corners, Grid, make_corners, make_curves, place_corners, place_curves

_OPTIONS = {"error_model": "numpy"}
Floats = NDArray[np.float32]
_TINY = np.float32(1e-30)  # numbers below are slow, and mean unreachable


class RowHistory(NamedTuple):
    """What one sweep leaves to the next, so that a row is done again only when a row it looks at has changed.

    `changed` and `seen` (rows,) hold when a row changed and when it was done last; `clock` (1,) counts the rows done.
    """

    changed: NDArray[np.int64]
    seen: NDArray[np.int64]
    clock: NDArray[np.int64]


class SweepSettings(NamedTuple):
    """How to interpolate.

    Attributes:
        rate: lambda [1/s].
        jump: a difference of phi [s] across a cell that no slope makes: the corners on the heavier side count alone.
            Infinite: unreachable corners count as what they are, w = 0.
        quiet: the largest change of phi [s] that does not count as one.
        curved: whether to add the curvature.
    """

    rate: float
    jump: float
    quiet: float
    curved: bool


@njit(**_OPTIONS)
def sweep(
    values: Floats,
    flags: NDArray[np.uint8],
    grid: Grid,
    durations: NDArray[np.float64],
    moves: Floats,
    controls: int,
    outcomes: Floats,
    row_near: NDArray[np.int64],
    memory: RowHistory,
    rule: SweepSettings,
    bits: int,
) -> tuple[np.float32, int]:
    """Do every row (the nodes along the last axis) whose surroundings have changed.

    `values`, `flags`: all nodes, flat, in the layout's order; values are changed. `durations`, `moves`, `controls`: see
    `steps.Steps`. `outcomes`, `row_near`: see `find_outcomes`; row_near (rows + 1,) counts the near nodes
    before each row. `bits`: bit k says to go down axis k, where the motion does not say which way to go.

    Returns:
        The largest change of phi [s], infinite where a node became reachable or unreachable; how many rows were done.
    """
    n = grid.counts.size
    slabs, pairs = durations.shape
    inner_size = values.size // slabs
    last = grid.counts[n - 1]
    index, down = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    corners, curves = make_corners(pairs, n, grid.n_outer), make_curves(pairs, n, grid.n_outer)
    plan, weights = np.zeros((pairs, PLAN), np.int64), np.zeros((pairs, WEIGHTS), np.float32)
    rows = np.zeros(pairs * ((1 << n) + 2 * n), np.int64)
    own = np.zeros(pairs, np.int64)
    buffers, found = np.zeros((3, last), np.float32), np.zeros((pairs, last), np.float32)
    jump, quiet = np.float32(rule.jump * rule.rate), np.float32(rule.quiet * rule.rate)
    changed, seen, clock = memory
    largest, done = np.float32(0.0), 0
    for turn in range(slabs):
        rest, offset = turn, 0
        for k in range(grid.n_outer - 1, -1, -1):
            i = rest % grid.counts[k]
            rest //= grid.counts[k]
            index[k] = grid.counts[k] - 1 - i if (bits >> k) & 1 else i
            offset += index[k] * grid.strides[k]
        slab, slab_offset = offset // inner_size, offset
        for p in range(pairs):
            corners.number[p], curves.number[p] = 0, 0
            if durations[slab, p] > 0.0:
                weights[p, DISCOUNT] = np.exp(-rule.rate * durations[slab, p])
                place_corners(grid, index, moves[slab, p, 1], p, corners)
                if rule.curved and corners.number[p] > 0:
                    place_curves(grid, index, moves[slab, p, 1], p, curves)
        _directions(grid, moves[slab], corners, bits, down)
        for row_turn in range(inner_size // last):
            rest, offset = row_turn, slab_offset
            for k in range(n - 2, grid.n_outer - 1, -1):
                i = rest % grid.counts[k]
                rest //= grid.counts[k]
                index[k] = grid.counts[k] - 1 - i if down[k] else i
                offset += index[k] * grid.strides[k]
            n_rows = place_row(grid, index, offset, corners, curves, plan, weights, rows)
            here = offset // last
            fresh = seen[here] == 0
            for i in range(n_rows):
                fresh |= changed[rows[i] // last] > seen[here]
            if not fresh:
                continue
            done += 1
            clock[0] += 1
            seen[here] = clock[0]
            near = row_near[here + 1] if down[n - 1] else row_near[here] - 1
            change = _update_row(
                values,
                flags,
                controls,
                outcomes,
                near,
                plan,
                weights,
                offset,
                down[n - 1],
                jump,
                rule.curved or rule.jump == np.inf,
                grid.periodic[n - 1],
                buffers,
                found,
                own,
            )
            largest = max(largest, change)
            if change > quiet:
                clock[0] += 1  # later than `seen`: a row that looks at itself is done again
                changed[here] = clock[0]
    return largest / rule.rate, done


@njit(**_OPTIONS)
def _directions(grid: Grid, moves: Floats, corners: Corners, bits: int, down: NDArray[np.bool_]) -> None:
    """Go along each inner axis against the motion, so that what a node depends on is done before it."""
    for k in range(grid.n_outer, grid.counts.size):
        ahead, way = np.float32(0.0), np.float32(0.0)
        for p in range(len(moves)):
            if corners.number[p] > 0:
                ahead += moves[p, 1, k]
                way += abs(moves[p, 1, k])
        down[k] = ahead > 0.0 if abs(ahead) > 0.5 * way else ((bits >> k) & 1) == 1


@njit(**_OPTIONS)
def _update_row(
    values: Floats,
    flags: NDArray[np.uint8],
    controls: int,
    outcomes: Floats,
    near: int,
    plan: NDArray[np.int64],
    weights: Floats,
    offset: int,
    down: bool,
    jump: float,
    grow: bool,
    periodic: bool,
    buffers: Floats,
    found: Floats,
    own: NDArray[np.int64],
) -> np.float32:
    """Update the nodes of a row and return the largest relative change; with `grow`, w never falls, except to 0."""
    pairs, last = found.shape
    # Steps along the row use what has just been found there. In a game all pairs are needed at once: that takes longer.
    n_own = 0
    for p in range(pairs):
        if plan[p, SIZE] == 0:
            found[p, :] = 0.0
        elif plan[p, OWN] == 1 and pairs == controls:
            found[p, :] = 0.0
            own[n_own] = p
            n_own += 1
        else:
            interpolate_row(values, plan, weights, p, jump, periodic, buffers, found)
    news = buffers[0]
    _min_max_row(found, controls, news, buffers[1])
    largest = np.float32(0.0)
    step = -1 if down else 1
    for turn in range(last):
        j = last - 1 - turn if down else turn
        flag = flags[offset + j]
        if flag == FIXED:
            continue
        new = news[j]
        for i in range(n_own):
            p = own[i]
            found[p, j] = weights[p, DISCOUNT] * interpolate_node(
                values, plan, weights, p, j, jump, periodic, last, False
            )
            new = max(new, found[p, j])
        if flag == NEAR:
            near += step
            new = _near_value(values, plan, weights, found, outcomes, near, controls, j, jump, periodic)
        if new < _TINY:
            new = np.float32(0.0)
        elif grow and new < values[offset + j]:
            continue
        old = values[offset + j]
        if new != old:
            values[offset + j] = new
            change = abs(new - old) / max(new, old) if min(new, old) > 0.0 else np.float32(np.inf)
            largest = max(largest, change)
    return largest


@njit(**_OPTIONS)
def _min_max_row(found: Floats, controls: int, news: Floats, best: Floats) -> None:
    """Fill news with the least over the disturbances of the most over the controls, along a row."""
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
def _near_value(
    values: Floats,
    plan: NDArray[np.int64],
    weights: Floats,
    found: Floats,
    outcomes: Floats,
    near: int,
    controls: int,
    j: int,
    jump: float,
    periodic: bool,
) -> np.float32:
    """Return the new value of a node near target or obstacles."""
    pairs, last = found.shape
    worst = np.float32(1.0)
    for first in range(0, pairs, controls):
        best = np.float32(0.0)
        for p in range(first, first + controls):
            outcome = outcomes[near, p]
            if outcome > 0.0:
                best = max(best, outcome)
            elif outcome == PASSES_TARGET and plan[p, SIZE] > 0:
                w = interpolate_node(values, plan, weights, p, j, jump, periodic, last, True)
                best = max(best, weights[p, DISCOUNT] * w)
            elif outcome != BLOCKED:
                best = max(best, found[p, j])
        worst = min(worst, best)
    return worst
