"""Flags of the nodes: inside target or obstacles, within reach of them, or far from both."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import position_indices
from ttr_reward_node.kernels.boundary_conditions import FIXED, FREE, LOST, NEAR
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.steps import Layout

BEYOND = 1.05
"""Distance beyond the reach of a step that may affect it, because of its extension [cells]."""
_BLOCK = 1 << 11  # number of nodes examined at once
_ROUNDING = 1e-6  # distance below which a node lies on a limit [cells]


def flag_nodes(problem: TimeToReachProblem, layout: Layout, reach: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Return the flag of each node (nodes,), flat in the layout's order.

    It is FIXED in the target, FIXED | LOST where every trajectory has failed, NEAR where a step may come within a cell
    of target or obstacles, and FREE elsewhere.

    Args:
        problem: Problem with target, obstacles and limits.
        layout: Order of the axes.
        reach: Lowest and highest cell along each axis over all steps of a slab (slabs, n, 2).
    """
    failed = problem.blocked() | _beyond_limits(problem, layout)
    flags = np.where(flat(failed, layout), np.uint8(FIXED | LOST), np.uint8(FREE))
    flags[flat(problem.in_target() & ~failed, layout)] = FIXED
    del failed
    _flag_near(problem, layout, reach, flags)
    return flags


def _flag_near(problem: TimeToReachProblem, layout: Layout, reach: NDArray[np.int8], flags: NDArray[np.uint8]) -> None:
    """Flag the free nodes (nodes,), flat, from which a step may come within a cell of target or obstacles."""
    shaped = flags.reshape(layout.slabs, *layout.counts[len(layout.outer) : len(layout.order)])
    block = max(1, _BLOCK // math.prod(shaped.shape[1:]))
    for begin in range(0, layout.slabs, block):
        slabs = np.arange(begin, min(begin + block, layout.slabs))
        near = np.ones((1,) * shaped.ndim, dtype=bool)
        for condition in _may_reach_target(problem, layout, slabs, reach[slabs]):
            near = near & condition
        if problem.clearance is not None:
            near = near | _may_reach_obstacle(problem, layout, slabs, reach[slabs])
        some = shaped[slabs[0] : slabs[-1] + 1]
        some[np.broadcast_to(near, some.shape) & (some == FREE)] = NEAR


def _may_reach_target(
    problem: TimeToReachProblem, layout: Layout, slabs: NDArray[np.int64], reach: NDArray[np.int8]
) -> Iterator[NDArray[np.bool_]]:
    """Yield, per axis of the target, a condition that broadcasts to the nodes of slabs (k,), shape (k, inner counts).

    `reach` (k, n, 2) [cells] is the slabs' reach.
    """
    for k, low, high in target_spans(problem):
        axis = problem.axes[k]
        nodes = _on_slabs(layout, problem.along(k, axis.nodes), slabs) / axis.spacing
        ahead = reach[:, layout.order.index(k)].reshape(-1, *(1,) * len(layout.inner), 2)
        lower, upper = nodes + (ahead[..., 0] - BEYOND), nodes + (ahead[..., 1] + BEYOND)
        turns = (-axis.count, 0, axis.count) if axis.periodic else (0,)
        meets = [(upper + t >= low / axis.spacing) & (lower + t <= high / axis.spacing) for t in turns]
        yield np.logical_or.reduce(meets)


def _may_reach_obstacle(
    problem: TimeToReachProblem, layout: Layout, slabs: NDArray[np.int64], reach: NDArray[np.int8]
) -> NDArray[np.bool_]:
    """Whether obstacles are within reach of the slabs' nodes; arguments and shape as in `_may_reach_target`."""
    assert problem.clearance is not None
    spacings = np.array([problem.axes[k].spacing for k in plane(problem)])
    places = [layout.order.index(k) for k in plane(problem)]
    cells = np.abs(reach[:, places].astype(np.float64)).max(axis=-1)
    far = np.linalg.norm((cells + BEYOND) * spacings, axis=-1)
    clearance = _on_slabs(layout, problem.spread(problem.clearance.values), slabs)
    return clearance <= far.reshape(-1, *(1,) * len(layout.inner))


def _on_slabs(layout: Layout, values: NDArray[Any], slabs: NDArray[np.int64]) -> NDArray[Any]:
    """Select slabs (k,) of values that broadcast to the grid; the result broadcasts to (k, inner counts)."""
    outer = len(layout.outer)
    if not outer:
        return values.transpose(layout.order)[None]
    values = values.transpose(layout.order)
    index = np.unravel_index(slabs, tuple(layout.counts[:outer]))
    return values[tuple(at if values.shape[k] > 1 else np.zeros_like(at) for k, at in enumerate(index))]


def _beyond_limits(problem: TimeToReachProblem, layout: Layout) -> NDArray[np.bool_]:
    """Whether nodes (grid shape) lie beyond the state's limits, where every trajectory has failed.

    Steps are truncated at a limit of an outer axis, which may lie between two nodes: the outer one is kept, so that the
    value can be interpolated between both.
    """
    beyond = np.zeros((1,) * len(problem.axes), dtype=bool)
    for k, axis in enumerate(problem.axes):
        low, high = problem.limits[:, k]
        slack = (1.0 - _ROUNDING if k in layout.outer else _ROUNDING) * axis.spacing
        beyond = beyond | problem.along(k, (axis.nodes < low - slack) | (axis.nodes > high + slack))
    return np.broadcast_to(beyond, problem.counts)


def target_spans(problem: TimeToReachProblem) -> Iterator[tuple[int, float, float]]:
    """Yield each axis of the target with the target's ends along it; a disc has two axes."""
    names = problem.system.state_names
    for name, (low, high) in problem.target.intervals.items():
        yield names.index(name), low, high
    if (disc := problem.target.disc) is not None:
        for k, middle in zip(position_indices(names), disc.centre, strict=True):
            yield k, middle - disc.radius, middle + disc.radius


def plane(problem: TimeToReachProblem) -> tuple[int, ...]:
    """Return the axes of the clearance."""
    return () if problem.clearance is None else problem.clearance.axes


def flat(shaped: NDArray[Any], layout: Layout) -> NDArray[Any]:
    """Flatten values at the nodes (grid shape) in the layout's order."""
    return np.ascontiguousarray(shaped.transpose(layout.order)).ravel()
