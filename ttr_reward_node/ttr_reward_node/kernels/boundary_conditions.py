"""Compiled checks of which steps hit the target or an obstacle between nodes; computed once, before the sweeps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ttr_reward_node.kernels.stencil import Grid

FREE, NEAR, FIXED, LOST = 0, 1, 2, 4
"""Node flags: far from target and obstacles; within reach of one; inside one. LOST is added to one of these when the
first phase has found that the target cannot be reached from the node."""

INTERPOLATE, BLOCKED, PASSES_TARGET = 0.0, -1.0, -2.0
"""Outcomes of a step: interpolate at its end; it hits an obstacle; it passes the target, so skip the target's nodes."""

_OPTIONS = {"error_model": "numpy"}
# Clearance of normal and long steps [cells]: a robot that follows steps grazing an obstacle collides with it.
MARGIN, MARGIN_OF_LONG = 0.15, 0.6


class BoundaryConditions(NamedTuple):
    """Target and obstacles for compiled code, axes in the layout's order.

    Attributes:
        box: Intervals of the target (n, 2) [cells], infinite for free states.
        disc: Target disc: centre (2) relative to the first node [m], radius [m], spacings (2) [m].
        disc_axes: Indices of the disc's two axes, -1 without a disc.
        clearance: Distance to the nearest obstacle at the nodes (count, count) [m].
        clearance_axes: Indices of the clearance's axes, twice the same for one axis, -1 without obstacles.
        cell: Largest spacing of the clearance's axes [m].
    """

    box: NDArray[np.float64]
    disc: NDArray[np.float64]
    disc_axes: NDArray[np.int64]
    clearance: NDArray[np.float32]
    clearance_axes: NDArray[np.int64]
    cell: float


class Paths(NamedTuple):
    """Paths of the steps from k slabs, as straight segments.

    Attributes:
        durations: Durations (k, pairs) [s]; 0 if there is no step.
        moves: Displacements from the start after each segment (k, pairs, parts, n) [cells].
        ahead: Displacements from the end after each segment of a short extension of the step (k, pairs, pieces, n)
            [cells].
        more: Duration of the extension (k, pairs) [s]; 0 without one.
        reach: Largest distance from the start in the plane of the obstacles (k, pairs) [m].
    """

    durations: NDArray[np.float64]
    moves: NDArray[np.float32]
    ahead: NDArray[np.float32]
    more: NDArray[np.float64]
    reach: NDArray[np.float64]


@njit(**_OPTIONS)
def find_outcomes(
    nodes: NDArray[np.int64],
    slabs: NDArray[np.int64],
    paths: Paths,
    grid: Grid,
    long: NDArray[np.bool_],
    boundary: BoundaryConditions,
    rate: float,
    outcomes: NDArray[np.float32],
) -> None:
    """Fill `outcomes` (N, pairs) of nodes (N,): the discount exp(-rate t) if the step hits the target, else a code.

    A step that ends in a cell cut by the target's edge is extended a little under the same control to find the hit:
    interpolation there would lengthen every path by a fraction of a cell.

    Args:
        nodes: Nodes near the target or an obstacle (N,).
        slabs: Row of `paths` with the steps of each node (N,).
        paths: Paths of the steps.
        grid: Axes in the layout's order.
        long: Whether the steps of each pair are long (pairs,).
        boundary: Target and obstacles.
        rate: Rate lambda of the transform [1/s].
        outcomes: Output (N, pairs).
    """
    n = grid.n
    pairs = paths.durations.shape[1]
    start, end = np.zeros(n), np.zeros(n)
    for i in range(len(nodes)):
        for k in range(n):
            start[k] = nodes[i] // grid.strides[k] % grid.counts[k]
        free = _clearance(start, boundary)
        for p in range(pairs):
            duration, move = paths.durations[slabs[i], p], paths.moves[slabs[i], p]
            outcomes[i, p] = INTERPOLATE
            if duration == 0.0:
                continue
            margin = (MARGIN_OF_LONG if long[p] else MARGIN) * boundary.cell
            t = _classify_step(start, move, free <= paths.reach[slabs[i], p] + margin, margin, grid, boundary)
            if 0.0 <= t <= 1.0:
                outcomes[i, p] = np.exp(-rate * t * duration)
                continue
            if t < 0.0:
                outcomes[i, p] = BLOCKED
                continue
            for k in range(n):
                end[k] = start[k] + move[-1, k]
            if _within_cell_of_target(end, grid, boundary):
                more = paths.more[slabs[i], p]
                t = _classify_step(end, paths.ahead[slabs[i], p], True, 0.0, grid, boundary) if more > 0.0 else 2.0
                outcomes[i, p] = np.exp(-rate * (duration + t * more)) if 0.0 <= t <= 1.0 else PASSES_TARGET


@njit(**_OPTIONS)
def _classify_step(
    start: NDArray[np.float64],
    move: NDArray[np.float32],
    obstacles: bool,
    margin: float,
    grid: Grid,
    boundary: BoundaryConditions,
) -> float:
    """Return the fraction of the step at which it hits the target; 2 for a miss, -1 if an obstacle blocks it.

    Args:
        start: Start of the step (n,) [cells].
        move: Displacements after each straight segment (parts, n) [cells].
        obstacles: Whether an obstacle is near enough to be checked.
        margin: Clearance that the path must keep [m].
        grid: Axes in the layout's order.
        boundary: Target and obstacles.
    """
    aims = _may_hit(start, move, grid, boundary)
    if not (aims or obstacles):
        return 2.0
    for part in range(len(move)):
        t = _target_entry(start, move, part, grid, boundary) if aims else 2.0
        if obstacles and _obstacle_ahead(start, move, part, min(t, 1.0), margin, boundary):
            return -1.0
        if t <= 1.0:
            return (part + t) / len(move)
    return 2.0


@njit(**_OPTIONS)
def _may_hit(start: NDArray[np.float64], move: NDArray[np.float32], grid: Grid, boundary: BoundaryConditions) -> bool:
    """Whether the bounding box of a path meets the target's intervals: a cheap test, false for most steps."""
    box = boundary.box
    for k in range(grid.n):
        if box[k, 1] - box[k, 0] == np.inf:
            continue
        low, high = 0.0, 0.0
        for part in range(len(move)):
            low, high = min(low, move[part, k]), max(high, move[part, k])
        at = start[k]
        if grid.periodic[k]:
            middle = 0.5 * (box[k, 0] + box[k, 1])
            at -= np.round((at - middle) / grid.counts[k]) * grid.counts[k]
            if high - low > 0.25 * grid.counts[k]:
                continue
        if at + high < box[k, 0] - 1e-6 or at + low > box[k, 1] + 1e-6:
            return False
    return True


@njit(**_OPTIONS)
def _obstacle_ahead(
    start: NDArray[np.float64],
    move: NDArray[np.float32],
    part: int,
    end: float,
    margin: float,
    boundary: BoundaryConditions,
) -> bool:
    """Whether an obstacle blocks straight segment `part` of the step before its fraction `end`.

    The clearance is sampled at least every half cell: `problems.obstacles` ensures that obstacles are at least a cell
    thick.
    """
    i, j = boundary.clearance_axes[0], boundary.clearance_axes[1]
    if i < 0:
        return False
    from_i, from_j = start[i], start[j]
    by_i, by_j = move[part, i], move[part, j]
    if part > 0:
        from_i, from_j = from_i + move[part - 1, i], from_j + move[part - 1, j]
        by_i, by_j = by_i - move[part - 1, i], by_j - move[part - 1, j]
    count = max(1, int(np.ceil(2.0 * end * max(abs(by_i), abs(by_j)) - 1e-3)))
    for k in range(1, count + 1):
        way = end * k / count
        if clearance_at(boundary.clearance, from_i + way * by_i, 0.0 if i == j else from_j + way * by_j) <= margin:
            return True
    return False


@njit(**_OPTIONS)
def _target_entry(
    start: NDArray[np.float64], move: NDArray[np.float32], part: int, grid: Grid, boundary: BoundaryConditions
) -> float:
    """Return the fraction of straight segment `part` of the step at which it enters the target; 2 if it does not."""
    box = boundary.box
    enter, leave = 0.0, 1.0
    for k in range(grid.n):
        low, high = box[k, 0], box[k, 1]
        if high - low == np.inf:
            continue
        before = move[part - 1, k] if part > 0 else np.float32(0.0)
        a = start[k] + before
        if grid.periodic[k]:
            a -= np.round((a - 0.5 * (low + high)) / grid.counts[k]) * grid.counts[k]
        b = move[part, k] - before
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
        if part > 0:
            before_i, before_j = move[part - 1, i], move[part - 1, j]
        ax, ay = (start[i] + before_i) * dx - x, (start[j] + before_j) * dy - y
        bx, by = (move[part, i] - before_i) * dx, (move[part, j] - before_j) * dy
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
    """Whether a point outside the target is less than a cell away from it along every axis."""
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
def _clearance(start: NDArray[np.float64], boundary: BoundaryConditions) -> float:
    """Return the clearance at a node [m]; infinite without obstacles."""
    i, j = boundary.clearance_axes[0], boundary.clearance_axes[1]
    if i < 0:
        return np.inf
    return clearance_at(boundary.clearance, start[i], 0.0 if i == j else start[j])


@njit(**_OPTIONS)
def clearance_at(clearance: NDArray[np.float32], first: float, second: float) -> float:
    """Interpolate the clearance bilinearly [m] at a position [cells]; outside the grid, return the edge value."""
    a = min(max(first, 0.0), clearance.shape[0] - 1.0)
    b = min(max(second, 0.0), clearance.shape[1] - 1.0)
    i, j = int(a), int(b)
    i1, j1 = min(i + 1, clearance.shape[0] - 1), min(j + 1, clearance.shape[1] - 1)
    a -= i
    b -= j
    lower = clearance[i, j] * (1.0 - b) + clearance[i, j1] * b
    upper = clearance[i1, j] * (1.0 - b) + clearance[i1, j1] * b
    return lower * (1.0 - a) + upper * a
