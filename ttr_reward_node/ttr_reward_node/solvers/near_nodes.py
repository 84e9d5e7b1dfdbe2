"""Nodes near target and obstacles, and the outcome of each step from there: computed once, before the sweeps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import position_indices
from ttr_reward_node.kernels.boundary_conditions import FIXED, FREE, INTERPOLATE, NEAR, BoundaryConditions, Paths
from ttr_reward_node.kernels.entry_points import kernels
from ttr_reward_node.kernels.stencil import Grid, StepTable
from ttr_reward_node.kernels.step_tables import PARTS, trace_paths
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.held_motion import Block, Derivatives, HeldPairs
from ttr_reward_node.solvers.node_flags import BEYOND, plane, target_spans
from ttr_reward_node.solvers.steps import SMALL, Layout, Steps, slab_states
from ttr_reward_node.solvers.threads import for_each, share

_FURTHER = 1.5  # approximate extension of a step to find the target in the cell in which it ends [cells]
_BLOCK = 1 << 10  # number of outcomes computed at once; each needs about 3 kB


@dataclass(frozen=True, eq=False)
class NearNodes:
    """Effect of target, obstacles and limits on the nodes, flat in the layout's order.

    Attributes:
        values: w at the nodes before the first sweep (nodes,): 1 in the target, 0 elsewhere.
        flags: Flags (nodes,) of `node_flags.flag_nodes`, NEAR only where a step meets something.
        outcomes: Outcome of each pair's step from the near nodes (near nodes, pairs).
        before_row: Number of near nodes before each row (nodes along the last axis), shape (rows + 1,).
    """

    values: NDArray[np.float32]
    flags: NDArray[np.uint8]
    outcomes: NDArray[np.float32]
    before_row: NDArray[np.int64]


def find_near_nodes(
    problem: TimeToReachProblem,
    layout: Layout,
    steps: Steps,
    flags: NDArray[np.uint8],
    table: StepTable,
    grid: Grid,
    rate: float,
    follow: Callable[..., None] | None = None,
    block: int = _BLOCK,
) -> NearNodes:
    """Compute the outcomes of the steps from all nodes near enough to target or obstacles to meet them.

    Args:
        problem: Problem with target, obstacles and limits.
        layout: Order of the axes.
        steps: Steps of the slabs.
        flags: Flags of `node_flags.flag_nodes` (nodes,); those that no step meets become FREE.
        table: The same steps for compiled code.
        grid: Axes for compiled code.
        rate: Rate lambda of the transform [1/s].
        follow: Function with the signature of `kernels.boundary_conditions.find_outcomes`; default: that one, on the
            CPU.
        block: Number of outcomes per call of `follow`.
    """
    follow = _follow if follow is None else follow
    boundary = _boundary_conditions(problem, layout)
    spacings = np.array([axis.spacing for axis in problem.axes])
    derivatives = Derivatives(problem.system, steps.held)
    candidates = np.flatnonzero(flags == NEAR)
    inner = flags.size // layout.slabs
    pairs = steps.codes.shape[1]
    found = []
    for begin in range(0, len(candidates), max(1, block // pairs)):
        nodes = candidates[begin : begin + max(1, block // pairs)]
        slabs, local = np.unique(nodes // inner, return_inverse=True)
        parts = np.array_split(slabs, math.ceil(len(slabs) * pairs / _BLOCK))
        work = partial(_paths, problem, layout, steps, derivatives, spacings)
        paths = _joined(for_each(work, parts, alone=problem.points < SMALL))
        outcomes = np.empty((len(nodes), pairs), np.float32)
        follow(nodes, local, paths, grid, table.long, boundary, rate, outcomes)
        matters = (outcomes != INTERPOLATE).any(axis=1)
        flags[nodes[~matters]] = FREE
        found.append(outcomes[matters])
    outcomes = np.concatenate(found) if found else np.empty((0, pairs), np.float32)
    last = int(grid["counts"][grid["n"] - 1])
    per_row = np.count_nonzero((flags == NEAR).reshape(-1, last), axis=1)
    values = (flags == FIXED).astype(np.float32)
    return NearNodes(values, flags, outcomes, np.concatenate(([0], np.cumsum(per_row))))


def _joined(parts: list[Paths]) -> Paths:
    """Concatenate paths of groups of slabs."""
    return parts[0] if len(parts) == 1 else Paths(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _follow(*given: Any) -> None:
    """Fill in the outcomes of some nodes, in two threads."""
    share(partial(_follow_part, given), 2 if len(given[0]) > 1 else 1)


def _follow_part(given: tuple[Any, ...], part: int, parts: int) -> None:
    """Fill in part `part` of `parts` of the outcomes."""
    nodes, local, *rest, outcomes = given
    some = slice(part * len(nodes) // parts, (part + 1) * len(nodes) // parts)
    kernels().find_outcomes(nodes[some], local[some], *rest, outcomes[some])


def near_share(problem: TimeToReachProblem, cells: float) -> float:
    """Estimate the fraction of nodes from which a step of `cells` cells may meet target or obstacles."""
    conditions = _near_conditions(problem, np.full(len(problem.axes), cells + 1.0))
    share_ = math.prod(float(condition.mean()) for condition in conditions)
    if problem.clearance is not None:
        far = cells * math.hypot(*(problem.axes[k].spacing for k in problem.clearance.axes))
        share_ += float(np.mean(problem.clearance.values <= far))
    return min(share_, 1.0)


def _paths(
    problem: TimeToReachProblem,
    layout: Layout,
    steps: Steps,
    derivatives: Derivatives,
    spacings: NDArray[np.float64],
    slabs: NDArray[np.int64],
) -> Paths:
    """Recompute the paths of the steps from some slabs; the tables only hold their ends."""
    durations = steps.durations[steps.codes[slabs]]
    block = Block(derivatives, slab_states(problem, layout, slabs), spacings)
    paths = block.move_for(durations.ravel())
    moves = np.empty((*durations.shape, PARTS, len(layout.order)), np.float32)
    trace_paths(paths, np.argsort(np.array(layout.order)), durations.shape[1], moves)
    ends = block.ends
    row, column = np.nonzero(_ends_near_target(problem, layout, ends))
    held = HeldPairs(steps.held.u[column], steps.held.d[column])
    ahead, more = np.zeros((*durations.shape, 2, len(layout.order))), np.zeros(durations.shape)
    fastest = np.abs(paths.last.reshape(-1, *durations.shape)[:, row, column]).max(axis=0)
    ahead[row, column], more[row, column] = _go_on(problem, held, ends[row, column], fastest)
    forward = np.ascontiguousarray(ahead[..., layout.order], dtype=np.float32)
    reach = np.zeros(durations.shape)
    if across := plane(problem):
        places = [layout.order.index(k) for k in across]
        reach[:] = np.linalg.norm(moves[..., places] * spacings[list(across)], axis=-1).max(axis=-1)
    return Paths(durations, moves, forward, more, reach)


def _ends_near_target(problem: TimeToReachProblem, layout: Layout, ends: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether steps with ends (k, p, n) end within about a cell of the target, judged along the outer axes."""
    near = np.ones(ends.shape[:-1], dtype=bool)
    for k, low, high in target_spans(problem):
        axis = problem.axes[k]
        if k in layout.outer:
            offset = ends[..., k] - 0.5 * (low + high)
            if axis.periodic:
                offset -= np.round(offset / (axis.upper - axis.lower)) * (axis.upper - axis.lower)
            near &= np.abs(offset) <= 0.5 * (high - low) + BEYOND * axis.spacing
    return near


def _go_on(
    problem: TimeToReachProblem, held: HeldPairs, ends: NDArray[np.float64], fastest: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return displacements (m, 2, n) [cells] after each half of a short extension of m steps, and durations (m,) [s].

    `ends` (m, n) are the ends of the steps, and `fastest` (m,) the rates along the fastest axis there [cells/s].
    """
    spacings = np.array([axis.spacing for axis in problem.axes])
    moving = np.isfinite(fastest) & (fastest > 0.0)
    more = np.where(moving, _FURTHER / np.where(moving, fastest, 1.0), 0.0)
    with np.errstate(all="ignore"):
        half = problem.system.step(ends, *held, dt=0.5 * more[..., None])
        whole = problem.system.step(half, *held, dt=0.5 * more[..., None])
        ahead = np.stack((half - ends, whole - ends), axis=-2) / spacings
    # Two straight segments do not approximate a motion that stops or turns within that time.
    smooth = np.isfinite(ahead).all(axis=(-2, -1)) & (np.abs(ahead).max(axis=(-2, -1)) <= 2.0 * _FURTHER)
    more = np.where(smooth, more, 0.0)
    return np.where(smooth[..., None, None], ahead, 0.0), more


def _boundary_conditions(problem: TimeToReachProblem, layout: Layout) -> BoundaryConditions:
    """Return target and obstacles for compiled code."""
    box = np.tile((-np.inf, np.inf), (len(layout.order), 1))
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
    cell = max((problem.axes[k].spacing for k in plane(problem)), default=0.0)
    return BoundaryConditions(
        box, disc, disc_axes, np.ascontiguousarray(clearance, dtype=np.float32), clearance_axes, cell
    )


def _near_conditions(problem: TimeToReachProblem, cells: NDArray[np.float64]) -> Iterator[NDArray[np.bool_]]:
    """Yield, per axis of the target and for its disc, whether nodes lie within `cells` (n,) cells of it."""
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
