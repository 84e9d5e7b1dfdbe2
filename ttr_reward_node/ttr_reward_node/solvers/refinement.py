"""Solve on a finer grid than asked for, where that costs little, and keep the values at the nodes that were asked for.

A scheme of first order is off by a part of what happens within a cell: a path that brakes as late as it can, or turns
round a spring's corner, loses a little in every cell. In a plane, cells of a third or a quarter cost a second; on a
line nothing is blurred, and in space finer cells cost too much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis
from ttr_reward_node.problems.problem import Clearance, TimeToReachProblem
from ttr_reward_node.solvers.steps import make_layout, pairs, step_lengths, tried_controls

_WORK = 2_000_000, 10_000_000  # steps on the finer grid, about a second's: of each node by itself, or of rows alike
_FINEST = 4
_PLANE = 2  # axes


def choose_refinement(problem: TimeToReachProblem) -> int:
    """Return into how many cells each of the problem's is split: as many as cost little, 1 for none."""
    if len(problem.axes) != _PLANE:
        return 1
    layout = make_layout(problem)
    choices = len(pairs(problem, tried_controls(problem, layout))[0])
    if choices == 1:
        return 1  # nothing to choose between: a finer grid only takes more sweeps
    steps = choices * len(step_lengths(problem))
    for finer in range(_FINEST, 1, -1):
        nodes = math.prod(_count(axis, finer) for axis in problem.axes)
        if nodes * steps <= _WORK[1 if layout.inner else 0]:
            return finer
    return 1


def refine(problem: TimeToReachProblem, finer: int) -> TimeToReachProblem:
    """Return the problem on a grid whose cells are `finer` times as small; every node stays one."""
    if finer == 1:
        return problem
    axes = tuple(replace(axis, count=_count(axis, finer)) for axis in problem.axes)
    clearance = problem.clearance
    if clearance is not None:
        values = clearance.values
        for i, k in enumerate(clearance.axes):
            values = _between(values, i, problem.axes[k], finer)
        clearance = Clearance(clearance.axes, np.ascontiguousarray(values, dtype=np.float32))
    return replace(problem, axes=axes, clearance=clearance)


def coarsen(values: NDArray[np.float32], axes: Sequence[Axis], finer: int) -> NDArray[np.float32]:
    """Return the values at the nodes of `axes` out of those on the finer grid."""
    kept = np.ascontiguousarray(values[(slice(None, None, finer),) * len(axes)])
    assert kept.shape == tuple(axis.count for axis in axes)
    return kept


def _count(axis: Axis, finer: int) -> int:
    return axis.count * finer if axis.periodic else (axis.count - 1) * finer + 1


def _between(values: NDArray[np.float32], i: int, axis: Axis, finer: int) -> NDArray[np.float32]:
    """Return values along array axis i on the finer axis: linear, as obstacles are between the nodes anyway."""
    place = np.arange(_count(axis, finer)) / finer
    lower = np.minimum(place.astype(np.int64), axis.count - 1 if axis.periodic else axis.count - 2)
    share = (place - lower).astype(np.float32).reshape((-1,) + (1,) * (values.ndim - 1 - i))
    upper = (lower + 1) % axis.count
    return values.take(lower, axis=i) * (1.0 - share) + values.take(upper, axis=i) * share
