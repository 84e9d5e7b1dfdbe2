"""Solve on a finer grid than requested, if that costs little, and keep the values at the requested nodes.

The error of a first-order scheme is proportional to the change within a cell: a path that brakes as late as possible,
or turns round the corner of a spring's value, loses a little in every cell. On two axes, cells split into three or four
cost about a second; on one axis nothing is blurred, and on three or more finer cells cost too much.
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

_WORK = 2_000_000, 10_000_000  # number of steps that take about a second, with steps per node or shared by a row
_FINEST = 4
_PLANE = 2  # number of axes to refine


def choose_refinement(problem: TimeToReachProblem) -> int:
    """Return the number of cells into which to split each grid cell along each axis; 1 if more would cost much."""
    if len(problem.axes) != _PLANE:
        return 1
    layout = make_layout(problem)
    choices = len(pairs(problem, tried_controls(problem, layout))[0])
    if choices == 1:
        return 1  # without a choice of controls, a finer grid only takes more sweeps
    steps = choices * len(step_lengths(problem))
    for finer in range(_FINEST, 1, -1):
        nodes = math.prod(_count(axis, finer) for axis in problem.axes)
        if nodes * steps <= _WORK[1 if layout.inner else 0]:
            return finer
    return 1


def refine(problem: TimeToReachProblem, finer: int) -> TimeToReachProblem:
    """Return the problem on a grid with cells `finer` times smaller; every node remains a node."""
    if finer == 1:
        return problem
    axes = tuple(replace(axis, count=_count(axis, finer)) for axis in problem.axes)
    clearance = problem.clearance
    if clearance is not None:
        values = clearance.values
        for i, k in enumerate(clearance.axes):
            values = between(values, i, problem.axes[k], np.arange(_count(problem.axes[k], finer)) / finer)
        clearance = Clearance(clearance.axes, np.ascontiguousarray(values, dtype=np.float32))
    return replace(problem, axes=axes, clearance=clearance)


def coarsen(values: NDArray[np.float32], axes: Sequence[Axis], finer: int) -> NDArray[np.float32]:
    """Return the values at the nodes of `axes` from those on the finer grid."""
    kept = np.ascontiguousarray(values[(slice(None, None, finer),) * len(axes)])
    assert kept.shape == tuple(axis.count for axis in axes)
    return kept


def _count(axis: Axis, finer: int) -> int:
    return axis.count * finer if axis.periodic else (axis.count - 1) * finer + 1


def between(values: NDArray[np.float32], i: int, axis: Axis, place: NDArray[np.float64]) -> NDArray[np.float32]:
    """Interpolate values linearly along array axis i to places [nodes], as for obstacles between nodes in general."""
    lower = np.minimum(place.astype(np.int64), axis.count - 1 if axis.periodic else axis.count - 2)
    share = (place - lower).astype(np.float32).reshape((-1,) + (1,) * (values.ndim - 1 - i))
    upper = (lower + 1) % axis.count
    return values.take(lower, axis=i) * (1.0 - share) + values.take(upper, axis=i) * share
