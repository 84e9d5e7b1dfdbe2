"""Shortest paths round the obstacles: initial guesses where a straight line to the goal runs through one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from oc_baseline_node.problems.problem import OptimalControlProblem

Array = NDArray[np.float64]
_SPACING = 0.1
"""Spacing of the planner's nodes [m]."""
_ROOM, _TIGHT_PENALTY = 0.15, 4.0
"""A hop whose ends have less than this room beyond d_min [m] counts as longer, up to one and this many times longer:
solvers keep a little more than d_min, and find a way through the middle of a door easier to mend."""
_NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))
"""Neighbours of a node; the opposite ones follow."""


class ShortestPathPlanner:
    """Shortest paths to a problem's goal that keep d_min, over a grid of positions.

    Args:
        problem: Optimal control problem with bounded positions.
    """

    def __init__(self, problem: OptimalControlProblem) -> None:
        self._problem = problem
        low, high = problem.state_bounds[:, problem.positions]
        sides = [np.arange(a, b, _SPACING) for a, b in zip(low, high, strict=True)]
        self._points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        room = self._clearance_to_spare(self._points)
        free = room >= -1e-9
        graph = _graph(self._points, room, (len(sides[0]), len(sides[1])))
        goal = self._nearest(np.array(problem.goal), free)
        lengths, before = dijkstra(graph, indices=np.array([goal]), return_predecessors=True)
        self._reached, self._next = np.isfinite(lengths[0]), before[0]

    def is_straight(self, position: Array) -> bool:
        """Whether the straight line from a position (2,) to the goal keeps d_min."""
        goal = np.array(self._problem.goal)
        count = max(2, round(np.hypot(*(goal - position)) / (0.25 * _SPACING)))
        return bool(
            (
                self._clearance_to_spare(position + np.linspace(0.0, 1.0, count)[:, None] * (goal - position)) >= -1e-9
            ).all()
        )

    def path(self, position: Array, count: int) -> Array:
        """Return `count` points (count, 2) [m] that lead from a position (2,) to the goal at equal distances."""
        node = self._nearest(position, self._reached)
        nodes = [node]
        while self._next[node] >= 0:
            node = int(self._next[node])
            nodes.append(node)
        corners = np.vstack((position, self._points[nodes], self._problem.goal))
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
        at = np.linspace(0.0, along[-1], count)
        return np.column_stack([np.interp(at, along, corners[:, axis]) for axis in (0, 1)])

    def _clearance_to_spare(self, points: Array) -> Array:
        """Return how much more than d_min positions (..., 2) keep [m]."""
        states = np.zeros((*points.shape[:-1], len(self._problem.system.states)))
        states[..., self._problem.positions] = points
        return self._problem.margin(states)

    def _nearest(self, position: Array, among: NDArray[np.bool_]) -> int:
        apart = np.where(among, np.sum((self._points - position) ** 2, axis=1), np.inf)
        return int(np.argmin(apart))


def _graph(points: Array, room: Array, shape: tuple[int, int]) -> csr_array:
    """Return the lengths of the hops between nodes (N, 2) with room (N,) [m], longer where there is little."""
    free = room >= -1e-9
    index = np.arange(len(points)).reshape(shape)
    rows, columns = [], []
    for i, j in _NEIGHBOURS:
        below = slice(max(0, -j), shape[1] - max(0, j))
        above = slice(max(0, j), shape[1] - max(0, -j))
        rows.append(index[: shape[0] - i, below].ravel())
        columns.append(index[i:, above].ravel())
    a, b = np.concatenate(rows), np.concatenate(columns)
    both = free[a] & free[b]
    a, b = a[both], b[both]
    tight = 1.0 - np.clip(np.minimum(room[a], room[b]) / _ROOM, 0.0, 1.0)
    lengths = np.hypot(*(points[a] - points[b]).T) * (1.0 + _TIGHT_PENALTY * tight)
    once = csr_array((lengths, (a, b)), shape=(len(points), len(points)))
    return once + once.T
