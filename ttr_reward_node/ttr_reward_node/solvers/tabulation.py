"""Table of the steps: every control with every length from every slab, computed block by block in compiled code."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.kernels.step_tables import Limits, Tables, enter_steps
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.durations import DurationTable
from ttr_reward_node.solvers.held_motion import Block, Derivatives, HeldPairs
from ttr_reward_node.solvers.steps import (
    FEW_AXES,
    SMALL,
    Layout,
    Steps,
    blocks,
    crossing_time,
    pairs,
    slab_states,
    step_lengths,
    tried_controls,
)
from ttr_reward_node.solvers.threads import for_each

_SOME = 4096  # number of nodes at which the usefulness of a control is judged
_STIFF = 0.2  # duration below which only the fastest axis moves, relative to the slowest axis crossing a cell
_PATIENCE = 1.5  # maximum duration relative to the fastest pair at a node, in games on more than two axes


def make_steps(problem: TimeToReachProblem, layout: Layout) -> tuple[Steps, NDArray[np.int8]]:
    """Tabulate the steps: every control with every length of `step_lengths`.

    Returns:
        The steps, and their reach (slabs, n, 2): the lowest and highest cell along each axis over all steps of a slab.
        The reach is apart, since it is not needed for long, and memory is scarce.
    """
    cells = step_lengths(problem)
    u, d, controls = pairs(problem, tried_controls(problem, layout))
    spacings = np.array([axis.spacing for axis in problem.axes])
    crossing = crossing_time(problem)
    disturbances = len(u) // controls
    useful = _controls_to_keep(problem, layout, HeldPairs(u, d), crossing)
    keep = np.tile(useful, disturbances)
    held = HeldPairs(u[keep], d[keep])
    shape = (layout.slabs, disturbances, len(cells), int(useful.sum()))
    # During a long step, each player knows the other's next actions, which shifts the barriers of a pursuit on three or
    # more axes. On two axes the grid is finer, and a weak control next to a strong one needs long steps to move a cell.
    patient = disturbances == 1 or len(problem.axes) <= FEW_AXES
    derivatives, limits = Derivatives(problem.system, held), _truncating_limits(problem, layout)
    entered = Limits(limits[0], limits[1], np.argsort(np.array(layout.order)), len(layout.outer))
    durations = DurationTable(shape, crossing)
    tables = Tables(
        np.empty((*shape, len(layout.order)), np.int16),
        np.empty((*shape, len(layout.inner), 2), np.int8),
        np.zeros((layout.slabs, len(layout.order), 2), np.int8),
    )

    def tabulate(some: slice) -> None:
        states = slab_states(problem, layout, np.arange(some.start, some.stop))
        block = Block(derivatives, states, spacings, limits)
        for i, length in enumerate(cells):
            longest = None if patient else block.patience(length, _PATIENCE, shape[-1])
            paths = block.move_cells(length, longest)
            enter_steps(block.starts, paths, entered, some.start, i, tables)
            durations.enter(some, i, paths.h)

    for_each(tabulate, blocks(layout.slabs, len(held.u)), alone=problem.points < SMALL)
    n_pairs = math.prod(shape[1:])
    codes, book = durations.codes()
    u, d = (np.repeat(each.reshape(disturbances, 1, shape[-1], -1), len(cells), axis=1) for each in held)
    steps = Steps(
        held=HeldPairs(u.reshape(n_pairs, -1), d.reshape(n_pairs, -1)),
        lengths=np.tile(np.repeat(np.asarray(cells), shape[-1]), disturbances),
        codes=codes,
        durations=book,
        ends=tables.ends.reshape(layout.slabs, n_pairs, -1),
        ranges=tables.ranges.reshape(layout.slabs, n_pairs, len(layout.inner), 2),
        controls=len(cells) * shape[-1],
        crossing=crossing,
    )
    return steps, tables.reach


def _truncating_limits(problem: TimeToReachProblem, layout: Layout) -> NDArray[np.float64]:
    """Return the lowest and highest state (2, n) at which a step is truncated: the limits of the outer axes.

    Along an inner axis all nodes share the step, so it is not truncated; nodes from which it would leave the grid skip
    it.
    """
    limits = problem.limits.copy()
    limits[0, layout.inner], limits[1, layout.inner] = -np.inf, np.inf
    return limits


def _controls_to_keep(
    problem: TimeToReachProblem, layout: Layout, held: HeldPairs, crossing: float
) -> NDArray[np.bool_]:
    """Whether each control is kept: the vertices, and others unless all their steps are very short.

    For example, half of a torque that reverses a quadrotor's pitch rate within milliseconds achieves nothing that the
    full torque does not. The decision is based on the rates at a subset of the nodes.
    """
    controls = tried_controls(problem, layout)
    if not problem.system.controls:
        return np.ones(1, dtype=bool)
    vertex = np.isin(controls, problem.system.control_bounds).all(axis=-1)
    if vertex.all():
        return np.asarray(vertex)
    some = np.unique(np.linspace(0, layout.slabs - 1, _SOME).astype(np.int64))
    spacings = np.array([axis.spacing for axis in problem.axes])
    rates = Derivatives(problem.system, held).of(slab_states(problem, layout, some), spacings)
    with np.errstate(divide="ignore"):
        short = 1.0 / np.abs(rates).max(axis=0) < _STIFF * crossing
    return np.asarray(vertex | ~short.reshape(-1, len(controls)).all(axis=0))
