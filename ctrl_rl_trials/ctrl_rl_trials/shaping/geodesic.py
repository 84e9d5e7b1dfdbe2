"""Time along the shortest path around walls and obstacles, from the map alone and without dynamics."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from ctrl_rl_core.tasks import with_grid
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ctrl_rl_core import NavigationTask, Region
from ctrl_rl_trials.errors import TrialError
from ctrl_rl_trials.shaping.time_to_go import top_speed
from ttr_reward_node import TimeToReachProblem, problem_from_task

Array = NDArray[np.float64]
_SPACING = 0.05
"""Distance between nodes along the two axes [m]."""
_MOVES = [(i, j) for i, j in product(range(-2, 3), repeat=2) if math.gcd(i, j) == 1]
"""Steps to 16 neighbours, in nodes: paths are at most 2.8 % too long."""
_BESIDE = 2.0
"""Maximum distance from a state to the nearest node with a path for the state to have a time [nodes]."""


class GeodesicInSeconds:
    """Time along the shortest path to the goal that keeps the robot's radius from obstacles, at its maximum speed.

    The path may turn on the spot and enter the goal with any heading, so the time is a lower bound without dynamics.

    Args:
        task: Task in an arena.

    Attributes:
        longest: Largest finite time [s].

    Raises:
        TrialError: No node outside the goal has a path to it.
    """

    def __init__(self, task: NavigationTask) -> None:
        grid = with_grid(task)
        fine = {name: math.ceil((high - low) / _SPACING) + 1 for name, (low, high) in task.plane_bounds.items()}
        problem = problem_from_task(grid, counts=fine, inflation=task.robot.radius)
        if problem.clearance is None:
            raise TrialError(f"task '{task.name}' has no plane of positions, so no shortest path")
        self._plane = list(problem.clearance.axes)
        axes = [problem.axes[k] for k in self._plane]
        spacings = np.array([axis.spacing for axis in axes])
        ways = _path_lengths(problem.clearance.values > 0.0, _in_goal(problem), spacings)
        found = np.isfinite(ways)
        if not (found & (ways > 0.0)).any():
            raise TrialError(f"task '{task.name}': no shortest path leads to its goal")
        apart, nearest = distance_transform_edt(~found, return_indices=True)
        times = np.where(apart <= _BESIDE, ways[tuple(nearest)] + apart * spacings.min(), np.inf) / top_speed(task)
        self.longest = float(times[np.isfinite(times)].max())
        self._times = RegularGridInterpolator([axis.nodes for axis in axes], times)
        self._low, self._high = np.array([(axis.lower, axis.upper) for axis in axes]).T

    def times(self, states: Array) -> Array:  # noqa: D102 - see Potential
        with np.errstate(invalid="ignore"):  # infinite times at corners of weight 0
            found = self._times(np.clip(np.asarray(states)[:, self._plane], self._low, self._high))
        return np.where(np.isnan(found), np.inf, found)


def _in_goal(problem: TimeToReachProblem) -> NDArray[np.bool_]:
    """Return which nodes of the plane lie in the goal, regardless of the other states."""
    assert problem.clearance is not None
    axes = [problem.axes[k] for k in problem.clearance.axes]
    names = tuple(axis.name for axis in axes)
    target = problem.target
    place = Region({name: each for name, each in target.intervals.items() if name in names}, target.disc)
    points = np.stack(np.meshgrid(*(axis.nodes for axis in axes), indexing="ij"), axis=-1)
    return np.asarray(place.contains(names, points.reshape(-1, 2))).reshape(points.shape[:-1])


def _path_lengths(free: NDArray[np.bool_], goal: NDArray[np.bool_], spacings: Array) -> Array:
    """Return the length of the shortest path from each node to the goal [m]; +inf without a path."""
    numbers = np.arange(free.size).reshape(free.shape)
    rows, columns, lengths = [], [], []
    for move in _MOVES:
        here = free & _shifted(free, move)
        for between in _passed(move):  # a path must not cut the corner of an obstacle
            here &= _shifted(free, between)
        rows.append(numbers[here])
        columns.append(numbers[here] + move[0] * free.shape[1] + move[1])
        lengths.append(np.full(len(rows[-1]), float(np.hypot(*(np.array(move) * spacings)))))
    graph = coo_array(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), (free.size, free.size)
    )
    starts = numbers[goal & free]
    if not len(starts):
        return np.full(free.shape, np.inf)
    return np.asarray(dijkstra(graph.tocsr(), indices=starts, min_only=True)).reshape(free.shape)


def _passed(move: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the nodes beside the straight line of a diagonal step."""
    (i, j), (a, b) = move, (int(np.sign(move[0])), int(np.sign(move[1])))
    if abs(i) + abs(j) == 1:
        return []
    return [(a, b), (a if abs(i) == 2 else 0, b if abs(j) == 2 else 0)] if abs(i) != abs(j) else [(a, 0), (0, b)]


def _shifted(flags: NDArray[np.bool_], move: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the flag of the node that each node's step leads to; False beyond the edge."""
    padded = np.pad(flags, 2)
    rows, columns = flags.shape
    return padded[2 + move[0] : 2 + move[0] + rows, 2 + move[1] : 2 + move[1] + columns]
