"""Solution on about half as many nodes along each axis: how much the times change shows how exact they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import Axis, Interval, Region, ValueGrid
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.problem import Clearance, TimeToReachProblem
from ttr_reward_node.problems.problem_checks import least_count
from ttr_reward_node.solvers.refinement import between, refine

_STATES = 2000
_EXACT = 0.01  # median relative difference of the times below which nothing is advised
_CELLS = 2.0  # distance from the target below which times are as small as the error of a cell [coarser cells]


def coarser_problem(problem: TimeToReachProblem, finer: int) -> TimeToReachProblem | None:
    """Return the problem on a grid with about twice the spacing of the one that was solved.

    None if every axis has the minimum number of nodes. A coarser grid closes narrow passages.

    Args:
        problem: Problem as posed.
        finer: Number of cells into which the solver split each of its cells along each axis.
    """
    if finer > 1:
        return refine(problem, finer // 2)
    counts = [max(least_count(axis.periodic), (axis.count + 1) // 2) for axis in problem.axes]
    axes = tuple(replace(axis, count=min(axis.count, count)) for axis, count in zip(problem.axes, counts, strict=True))
    if axes == problem.axes:
        return None
    clearance = problem.clearance
    if clearance is not None:
        values = clearance.values
        for i, k in enumerate(clearance.axes):
            values = between(values, i, problem.axes[k], _places(problem.axes[k], axes[k].count))
        clearance = Clearance(clearance.axes, np.ascontiguousarray(values, dtype=np.float32))
    try:
        return replace(problem, axes=axes, clearance=clearance, digest="")
    except TimeToReachError:  # the target or a limit lies between two nodes
        return None


def _places(axis: Axis, count: int) -> NDArray[np.float64]:
    """Return where the nodes of the axis with another count lie [nodes]."""
    end = axis.count if axis.periodic else axis.count - 1
    return np.linspace(0.0, end, count, endpoint=not axis.periodic)


def grid_note(problem: TimeToReachProblem, value: ValueGrid, coarser: ValueGrid, finer: int, advice: str) -> str:
    """Return a line that says how far the times of two grids differ.

    Args:
        problem: Problem as posed.
        value: Its solution.
        coarser: Solution of `coarser_problem`.
        finer: As in `coarser_problem`.
        advice: What to change if they differ by more than 1 %.
    """
    solved = " x ".join(str(axis.count) for axis in refine(problem, finer).axes)
    grid = f"on {' x '.join(str(axis.count) for axis in coarser.axes)} nodes in place of {solved}"
    states = _draw_states(problem, coarser.axes)
    if len(states) == 0:
        return "" if problem.in_target().all() else f"{grid} every state is within two cells of the target: {advice}"
    times, others = value.value(states), coarser.value(states)
    there = np.isfinite(times) & (times > 0.0)
    both = there & np.isfinite(others)
    if not both.any():
        return f"{grid} nothing reaches the target: {advice}" if there.any() else ""
    times, others = times[both].astype(np.float64), others[both]
    change = float(np.median(np.abs(others - times) / times))
    return f"{grid} times differ by {100.0 * change:.2g} % (median)" + (f": {advice}" if change > _EXACT else "")


def _draw_states(problem: TimeToReachProblem, axes: Sequence[Axis]) -> NDArray[np.float64]:
    """Draw states (N, n) that are more than a few cells of some axes away from the target."""
    ends = np.array([[axis.lower for axis in problem.axes], [axis.upper for axis in problem.axes]])
    lower, upper = np.clip(ends, *problem.limits)
    states = np.random.default_rng(0).uniform(lower, upper, (_STATES, len(lower)))
    target, around = problem.target, {axis.name: _CELLS * axis.spacing for axis in axes}
    shifted, intervals, disc = states.copy(), {}, target.disc
    for k, axis in enumerate(axes):
        if axis.name in target.intervals:
            low, high = target.intervals[axis.name]
            intervals[axis.name] = Interval(low - around[axis.name], high + around[axis.name])
            if axis.periodic:
                period = axis.upper - axis.lower
                shifted[:, k] -= period * np.round((shifted[:, k] - 0.5 * (low + high)) / period)
    if disc is not None:
        disc = replace(disc, radius=disc.radius + max(around.values()))
    return states[~Region(intervals, disc).contains(problem.system.state_names, shifted)]
