"""The semi-Lagrangian solver: from each node to where the controls take it in a few cells, until nothing changes.

It sweeps in three phases. First without any judgement of what is unreachable: w only grows, towards the one solution of
a monotone scheme, so no node can come to lean on others that lean on it. Nodes that lose weight to the unreachable on
the way, or take so long that only the blur of interpolation can have brought them to the target, fall below _CUT: they
are taken to be unreachable, and have to be reached anew in the second phase, which makes the edge of what can be
reached sharp. At last the curvature of `kernels.row_interpolation` is added; w then only grows, because a scheme with
curvature is not monotone and would go to and fro.

Finite jumps stay as wide as linear interpolation makes them, a few cells, on the side of longer times: sharpened ones
are nearer the truth on average, but who steers by them drives over the edge.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import position_indices
from ttr_reward_node.kernels.boundary_conditions import FIXED, NEAR, BoundaryConditions
from ttr_reward_node.kernels.entry_points import kernels
from ttr_reward_node.kernels.stencil import StepTable, make_grid
from ttr_reward_node.kernels.sweep import Nodes, RowHistory, SweepSettings
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.solution import Progress, SweepResult, require_memory
from ttr_reward_node.solvers.steps import Layout, Steps, make_layout, make_steps, pairs

CELLS = (2.0, 3.0)
"""Lengths of the steps [cells]. Under about one a node refers to itself. The second length reaches end points, and on a
lattice of headings the headings, that the first one cannot reach."""

# All in units of the time that the slowest axis takes to cross a cell at its top speed.
_TOLERANCE = 0.1
_SETTLED = (330.0, 0.2)  # the first and second phase hand over to the next when changes are below this
_PATIENCE = 40  # sweeps of the second phase, in which marginal nodes can go to and fro
_QUIET = (33.0, 0.03, 0.01)  # in each phase: a row whose changes are below this does not wake those that look at it
_CUT = 0.985  # w of a node that the first phase leaves standing; with _CROSSINGS, up to one and a half crossings
_BLOCK = 1 << 10  # slabs that are looked at at once
_CROSSINGS = 100.0  # 1 / lambda, in crossings of the grid


def memory_needed(problem: TimeToReachProblem) -> float:
    """Return the bytes that `solve` will take at most, with those of the value grid."""
    layout = make_layout(problem)
    n = len(layout.counts)
    n_pairs = len(CELLS) * len(pairs(problem, problem.control_counts)[0])
    # Durations, twice where controls are left out, and moves; the states.
    steps = layout.slabs * (n_pairs * (16.0 + 8.0 * n) + 24.0 * n)
    # Without the grid itself, which may be what does not fit.
    conditions = _near_conditions(problem, np.full(len(problem.axes), max(CELLS) + 1.0))
    near_target = math.prod(float(condition.mean()) for condition in conditions)
    near_obstacle = 0.0
    if problem.clearance is not None:
        far = max(CELLS) * math.hypot(*(problem.axes[k].spacing for k in problem.clearance.axes))
        near_obstacle = float(np.mean(problem.clearance.values <= far))
    near = (near_target + near_obstacle) * problem.points * n_pairs * 4.0
    rows = 24.0 * problem.points / layout.counts[-1]
    return steps + near + rows + problem.points * 17.0 + 2.5e8  # the last for compiling


def solve(
    problem: TimeToReachProblem,
    *,
    tolerance: float | None = None,
    max_sweeps: int = 300,
    progress: Progress | None = None,
) -> SweepResult:
    """Solve a problem, with the arguments of `solver.solve`."""
    require_memory(memory_needed(problem), problem.points)
    layout = make_layout(problem)
    steps = make_steps(problem, layout, CELLS)
    unit = steps.longest
    tolerance = _TOLERANCE * unit if tolerance is None else tolerance
    crossing = unit * max(layout.counts)
    rate = 1.0 / (_CROSSINGS * crossing) if crossing > 0.0 else 1.0
    grid = make_grid(layout.counts, layout.periodic, len(layout.outer))
    shaped = _flags(problem, layout, steps)
    values = flat((shaped == FIXED) & ~problem.blocked(), layout).astype(np.float32)
    flags = flat(shaped, layout)
    last = int(layout.counts[-1])
    row_near = np.concatenate(([0], np.cumsum(np.count_nonzero((flags == NEAR).reshape(-1, last), axis=1))))
    outcomes = np.empty((int(row_near[-1]), steps.durations.shape[1]), np.float32)
    table = StepTable(steps.durations, steps.moves, steps.controls)
    kernels().find_outcomes(flags, grid, table, _boundary_conditions(problem, layout), rate, outcomes)
    nodes = Nodes(values, flags, outcomes, row_near)
    n_rows = len(row_near) - 1
    history = RowHistory(np.zeros(n_rows, np.int64), np.zeros(n_rows, np.int64), np.zeros(1, np.int64))
    quiet = [q * unit for q in _QUIET[:2]] + [min(_QUIET[2] * unit, 0.1 * tolerance)]
    phases = [SweepSettings(rate, math.inf, quiet[0], False)]
    phases += [SweepSettings(rate, crossing, q, curved) for q, curved in zip(quiet[1:], (False, True), strict=True)]
    residual, number, in_phase = math.inf, 0, 0
    while number < max_sweeps:
        bits = in_phase % (1 << len(layout.counts))
        residual, _ = kernels().sweep(nodes, grid, table, history, phases[0], bits)
        number, in_phase = number + 1, in_phase + 1
        if progress is not None:
            progress(number, residual)
        settled = len(phases) > 1 and residual <= _SETTLED[3 - len(phases)] * unit and in_phase > 1
        if settled or (len(phases) == 2 and in_phase == _PATIENCE):
            if math.isinf(phases[0].jump):
                values[values < _CUT] = 0.0
            phases.pop(0)
            history.seen[:] = 0
            in_phase = 0
        elif len(phases) == 1 and residual <= tolerance:
            break
    if len(phases) > 1:  # given up: what has barely been reached would become times of hours
        values[values < _CUT] = 0.0
    with np.errstate(divide="ignore"):
        np.log(values, out=values)
    values *= np.float32(-1.0 / rate)
    phi = np.abs(values).reshape([problem.counts[k] for k in layout.order]).transpose(np.argsort(layout.order))
    return SweepResult(np.ascontiguousarray(phi), number, residual, len(phases) == 1 and residual <= tolerance)


def flat(shaped: NDArray[Any], layout: Layout) -> NDArray[Any]:
    """Values at the nodes (grid shape), flat in the layout's order."""
    return np.ascontiguousarray(shaped.transpose(layout.order)).ravel()


def _boundary_conditions(problem: TimeToReachProblem, layout: Layout) -> BoundaryConditions:
    """Return target and obstacles for compiled code."""
    box = np.tile((-np.inf, np.inf), (len(layout.counts), 1))
    for k, axis in enumerate(problem.axes):
        if axis.name in problem.target.intervals:
            low, high = problem.target.intervals[axis.name]
            box[layout.order.index(k)] = (low - axis.lower) / axis.spacing, (high - axis.lower) / axis.spacing
    disc, disc_axes = np.zeros(5), np.array([-1, -1])
    if problem.target.disc is not None:
        i, j = position_indices(problem.system.state_names)
        a, b, target = problem.axes[i], problem.axes[j], problem.target.disc
        disc[:] = target.centre[0] - a.lower, target.centre[1] - b.lower, target.radius, a.spacing, b.spacing
        disc_axes[:] = layout.order.index(i), layout.order.index(j)
    clearance, clearance_axes = np.zeros((1, 1), np.float32), np.array([-1, -1])
    if problem.clearance is not None:
        clearance = problem.clearance.values.reshape(problem.clearance.values.shape[0], -1)
        clearance_axes[:] = [layout.order.index(problem.clearance.axes[i]) for i in (0, -1)]
    return BoundaryConditions(box, disc, disc_axes, np.ascontiguousarray(clearance, dtype=np.float32), clearance_axes)


def _flags(problem: TimeToReachProblem, layout: Layout, steps: Steps) -> NDArray[np.uint8]:
    """Flag the nodes (grid shape): within a step, and a cell, of the target, or within a step of an obstacle: near."""
    order = list(layout.order)
    plane = [] if problem.clearance is None else [order.index(k) for k in problem.clearance.axes]
    spacings = np.array([problem.axes[order[k]].spacing for k in plane])
    most, far = np.zeros(len(order)), 0.0
    for begin in range(0, len(steps.moves), _BLOCK):  # a copy of all moves may not fit
        size = np.abs(steps.moves[begin : begin + _BLOCK])
        most = np.maximum(most, size.max(axis=(0, 1, 2))[: len(order)])
        far = max(far, float(np.linalg.norm(size[..., plane] * spacings, axis=-1).max()))
    reach = np.empty(len(order))
    reach[order] = most
    flags = np.where(_near_target(problem, reach + 1.0), np.uint8(NEAR), np.uint8(0))
    flags = np.array(np.broadcast_to(flags, problem.counts))
    if problem.clearance is not None:
        near = problem.clearance.values <= 1.01 * far
        flags[np.broadcast_to(problem.spread(near), problem.counts)] = NEAR
    flags[problem.blocked() | problem.in_target()] = FIXED
    return flags


def _near_target(problem: TimeToReachProblem, cells: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether nodes lie within so many cells (n,) of the target along every axis; broadcasts to the grid."""
    near = np.ones((1,) * len(problem.axes), dtype=bool)
    for condition in _near_conditions(problem, cells):
        near = near & condition
    return near


def _near_conditions(problem: TimeToReachProblem, cells: NDArray[np.float64]) -> Iterator[NDArray[np.bool_]]:
    """Yield what `_near_target` consists of: one condition an axis, and the disc's; each broadcasts to the grid."""
    for k, axis in enumerate(problem.axes):
        if axis.name in problem.target.intervals:
            low, high = problem.target.intervals[axis.name]
            offset = axis.nodes - 0.5 * (low + high)
            if axis.periodic:
                offset -= np.round(offset / (axis.upper - axis.lower)) * (axis.upper - axis.lower)
            yield problem.along(k, np.abs(offset) <= 0.5 * (high - low) + cells[k] * axis.spacing)
    if problem.target.disc is not None:
        i, j = position_indices(problem.system.state_names)
        points = np.stack(np.broadcast_arrays(*(problem.along(k, problem.axes[k].nodes) for k in (i, j))), axis=-1)
        far = math.hypot(*(cells[k] * problem.axes[k].spacing for k in (i, j)))
        yield problem.target.disc.signed_distance(points) <= far
