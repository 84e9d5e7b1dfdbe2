"""Outcomes of the steps near target and obstacles, between the nodes; found once, before the sweeps; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.stencil import Grid, StepTable

FREE, NEAR, FIXED = 0, 1, 2
"""Flags of nodes: far from everything; within reach of target or obstacle; in one of them."""

INTERPOLATE, BLOCKED, PASSES_TARGET = 0.0, -1.0, -2.0
"""Outcomes of a step: interpolate where it ends; it hits an obstacle; it passes by the target, so skip its nodes."""

_OPTIONS = {"error_model": "numpy"}


class BoundaryConditions(NamedTuple):
    """Target and obstacles for compiled code, axes in the layout's order.

    Attributes:
        box: Intervals of the target (n, 2) [cells], infinite where it is free.
        disc: Centre (2) from the first node and radius [m], then spacings (2) [m] of the target's disc.
        disc_axes: Indices of the disc's two axes, -1 for no disc.
        clearance: Distance to the nearest obstacle at the nodes (count, count) [m].
        clearance_axes: Indices of the clearance's axes, twice the same for one axis, -1 for no obstacles.
    """

    box: NDArray[np.float64]
    disc: NDArray[np.float64]
    disc_axes: NDArray[np.int64]
    clearance: NDArray[np.float32]
    clearance_axes: NDArray[np.int64]


@njit(**_OPTIONS)
def find_outcomes(
    flags: NDArray[np.uint8],
    grid: Grid,
    steps: StepTable,
    boundary: BoundaryConditions,
    rate: float,
    outcomes: NDArray[np.float32],
) -> None:
    """Fill `outcomes` (near nodes in order, pairs): the discount exp(-rate t) of a hit of the target, or a code.

    A step that ends in a cell which the target's edge cuts is followed by a second one to find the hit: interpolating
    there would lengthen every path by a part of a cell.
    """
    n = grid.n
    durations, moves, _ = steps
    slabs, pairs = durations.shape
    inner_size = flags.size // slabs
    start, end = np.zeros(n), np.zeros(n)
    near = 0
    for node in range(flags.size):
        if flags[node] != NEAR:
            continue
        for k in range(n):
            start[k] = node // grid.strides[k] % grid.counts[k]
        slab = node // inner_size
        for p in range(pairs):
            t = _classify_step(start, slab, p, grid, steps, boundary)
            if 0.0 <= t <= 1.0:
                outcomes[near, p] = np.exp(-rate * t * durations[slab, p])
                continue
            outcomes[near, p] = BLOCKED if t < 0.0 else INTERPOLATE
            if t < 0.0 or durations[slab, p] == 0.0:
                continue
            for k in range(n):
                end[k] = start[k] + moves[slab, p, 1, k]
            if _within_cell_of_target(end, grid, boundary):
                then = _best_target_hit(end, grid, steps, boundary, rate)
                outcomes[near, p] = then * np.exp(-rate * durations[slab, p]) if then > 0.0 else PASSES_TARGET
        near += 1


@njit(**_OPTIONS)
def _best_target_hit(
    start: NDArray[np.float64], grid: Grid, steps: StepTable, boundary: BoundaryConditions, rate: float
) -> float:
    """Discount of hitting the target within a step from between nodes; 0 if none does, whatever the disturbance."""
    durations, _, controls = steps
    slab, stride = 0, 1
    for k in range(grid.n_outer - 1, -1, -1):
        i = int(np.round(start[k]))
        i = i % grid.counts[k] if grid.periodic[k] else min(max(i, 0), grid.counts[k] - 1)
        slab += i * stride
        stride *= grid.counts[k]
    worst = 1.0
    for first in range(0, durations.shape[1], controls):
        best = 0.0
        for p in range(first, first + controls):
            t = _classify_step(start, slab, p, grid, steps, boundary)
            if 0.0 <= t <= 1.0:
                best = max(best, np.exp(-rate * t * durations[slab, p]))
        worst = min(worst, best)
    return worst


@njit(**_OPTIONS)
def _classify_step(
    start: NDArray[np.float64], slab: int, p: int, grid: Grid, steps: StepTable, boundary: BoundaryConditions
) -> float:
    """Fraction of the step after which the target is hit; 2 if it is missed, -1 if an obstacle blocks the path."""
    if steps.durations[slab, p] == 0.0:
        return 2.0
    move = steps.moves[slab, p]
    for half in range(2):
        t = _target_entry(start, move, half, grid, boundary)
        if _obstacle_ahead(start, move, half, min(t, 1.0), boundary):
            return -1.0
        if t <= 1.0:
            return 0.5 * (half + t)
    return 2.0


@njit(**_OPTIONS)
def _obstacle_ahead(
    start: NDArray[np.float64], move: NDArray[np.float32], half: int, end: float, boundary: BoundaryConditions
) -> bool:
    """Whether an obstacle blocks a half of the step, taken as straight, up to the fraction `end` of it.

    The clearance is sampled every half cell or closer: `problems.obstacles` makes sure that obstacles are at least a
    cell thick.
    """
    i, j = boundary.clearance_axes[0], boundary.clearance_axes[1]
    if i < 0:
        return False
    from_i, from_j = start[i], start[j]
    by_i, by_j = move[half, i], move[half, j]
    if half == 1:
        from_i, from_j = from_i + move[0, i], from_j + move[0, j]
        by_i, by_j = by_i - move[0, i], by_j - move[0, j]
    count = max(1, int(np.ceil(2.0 * end * max(abs(by_i), abs(by_j)) - 1e-3)))
    for k in range(1, count + 1):
        part = end * k / count
        if clearance_at(boundary.clearance, from_i + part * by_i, 0.0 if i == j else from_j + part * by_j) <= 0.0:
            return True
    return False


@njit(**_OPTIONS)
def _target_entry(
    start: NDArray[np.float64], move: NDArray[np.float32], half: int, grid: Grid, boundary: BoundaryConditions
) -> float:
    """Fraction of a half of the step, taken as straight, at which it enters the target; 2 if it does not."""
    box = boundary.box
    enter, leave = 0.0, 1.0
    for k in range(grid.n):
        low, high = box[k, 0], box[k, 1]
        if high - low == np.inf:
            continue
        before = move[0, k] if half == 1 else np.float32(0.0)
        a = start[k] + before
        if grid.periodic[k]:
            a -= np.round((a - 0.5 * (low + high)) / grid.counts[k]) * grid.counts[k]
        b = move[half, k] - before
        if b == 0.0:
            if a < low - 1e-6 or a > high + 1e-6:
                return 2.0
        else:
            t0, t1 = (low - a) / b, (high - a) / b
            enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
    i, j = boundary.disc_axes[0], boundary.disc_axes[1]
    if i >= 0:
        disc = boundary.disc
        x, y, radius, dx, dy = disc[0], disc[1], disc[2], disc[3], disc[4]
        before_i, before_j = np.float32(0.0), np.float32(0.0)
        if half == 1:
            before_i, before_j = move[0, i], move[0, j]
        ax, ay = (start[i] + before_i) * dx - x, (start[j] + before_j) * dy - y
        bx, by = (move[half, i] - before_i) * dx, (move[half, j] - before_j) * dy
        aa, ab, bb = ax * ax + ay * ay - radius * radius, ax * bx + ay * by, bx * bx + by * by
        square = ab * ab - aa * bb
        if square < 0.0 or (bb == 0.0 and aa > 0.0):
            return 2.0
        if bb > 0.0:
            root = np.sqrt(square)
            enter, leave = max(enter, (-ab - root) / bb), min(leave, (-ab + root) / bb)
    return enter if enter <= leave else 2.0


@njit(**_OPTIONS)
def _within_cell_of_target(end: NDArray[np.float64], grid: Grid, boundary: BoundaryConditions) -> bool:
    """Whether a point outside the target lies less than a cell from it along every axis."""
    box = boundary.box
    for k in range(grid.n):
        low, high = box[k, 0], box[k, 1]
        if high - low < np.inf:
            at = end[k]
            if grid.periodic[k]:
                at -= np.round((at - 0.5 * (low + high)) / grid.counts[k]) * grid.counts[k]
            if at <= low - 1.0 or at >= high + 1.0:
                return False
    i, j = boundary.disc_axes[0], boundary.disc_axes[1]
    if i >= 0:
        disc = boundary.disc
        x, y, radius, dx, dy = disc[0], disc[1], disc[2], disc[3], disc[4]
        return np.hypot(end[i] * dx - x, end[j] * dy - y) < radius + np.hypot(dx, dy)
    return True


@njit(**_OPTIONS)
def clearance_at(clearance: NDArray[np.float32], first: float, second: float) -> float:
    """Bilinear interpolation of the clearance [m] at a position [cells]; outside, that of the edge."""
    a = min(max(first, 0.0), clearance.shape[0] - 1.0)
    b = min(max(second, 0.0), clearance.shape[1] - 1.0)
    i, j = int(a), int(b)
    i1, j1 = min(i + 1, clearance.shape[0] - 1), min(j + 1, clearance.shape[1] - 1)
    a -= i
    b -= j
    lower = clearance[i, j] * (1.0 - b) + clearance[i, j1] * b
    upper = clearance[i1, j] * (1.0 - b) + clearance[i1, j1] * b
    return lower * (1.0 - a) + upper * a
