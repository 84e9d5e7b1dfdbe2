"""The best drive of a robot that has the map and sees closed doors: shortest ways, taken anew at each door it learns.

It moves at full speed without turning, and takes every door for open that it has not seen closed. Dijkstra on the
cells, and so no part of the navigator.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ctrl_rl_core import find_robot

_ROBOT = find_robot("turtlebot3_burger")
_TOLERANCE = 0.15
_MOVES = {
    (0, 1): (),
    (1, 0): (),
    (1, 1): ((0, 1), (1, 0)),
    (1, -1): ((0, -1), (1, 0)),
    (1, 2): ((0, 1), (1, 1)),
    (2, 1): ((1, 0), (1, 1)),
    (1, -2): ((0, -1), (1, -1)),
    (2, -1): ((1, 0), (1, -1)),
}
"""Moves between cells, one of each pair of opposite ones, and the cells on their way."""

Cells = NDArray[np.int8]
Leaf = tuple[slice, slice]


class Best(NamedTuple):
    """The best drive.

    Attributes:
        seconds: Time to the goal [s]; inf if every way is closed.
        learnt: Number of closed doors seen until then.
        until: Time until it arrives, or knows that every way is closed [s].
    """

    seconds: float
    learnt: int
    until: float


def plan(
    known: Cells, closed: list[Leaf], start: tuple[float, float], goal: tuple[float, float], resolution: float
) -> Best:
    """Return the drive of the best robot.

    Args:
        known: Cells of the map (rows, columns).
        closed: Rows and columns of the doors that are closed in the world.
        start: Where it starts [m].
        goal: Where it goes [m].
        resolution: Side of a cell [m].
    """
    real, believed, unseen = known.copy(), known.copy(), list(closed)
    for leaf in closed:
        real[leaf] = 100
    place = _cell(start, resolution)
    length, then = 0.0, _shortest(believed, goal, resolution)
    while True:
        seen = [leaf for leaf in unseen if _sees(real, place, leaf, resolution)]
        for leaf in seen:
            unseen.remove(leaf)
            believed[leaf] = 100
        if seen:
            then = _shortest(believed, goal, resolution)
        learnt, seconds = len(closed) - len(unseen), length * resolution / _ROBOT.speed
        if math.dist(place, _cell(goal, resolution)) * resolution <= _TOLERANCE:
            return Best(seconds, learnt, seconds)
        after = int(then[place[0] * known.shape[1] + place[1]])
        if after < 0:
            return Best(math.inf, learnt, seconds)
        row, column = divmod(after, known.shape[1])
        length += math.dist(place, (row, column))
        place = (row, column)


def _cell(point: tuple[float, float], resolution: float) -> tuple[int, int]:
    return int(point[1] / resolution), int(point[0] / resolution)


def _shortest(cells: Cells, goal: tuple[float, float], resolution: float) -> NDArray[np.int32]:
    """Return the next cell on the shortest way from each cell to the goal; negative without one."""
    free = distance_transform_edt(cells == 0) * resolution > _ROBOT.radius
    rows, columns = free.shape
    number = np.arange(rows * columns).reshape(rows, columns)
    sources, targets, lengths = [], [], []
    for move, between in _MOVES.items():
        fits = free & _moved(free, move)
        for step in between:
            fits &= _moved(free, step)
        here = number[fits]
        sources.append(here)
        targets.append(here + move[0] * columns + move[1])
        lengths.append(np.full(len(here), math.hypot(*move)))
    edges = (np.concatenate(lengths), (np.concatenate(sources), np.concatenate(targets)))
    graph = coo_array(edges, shape=(rows * columns,) * 2).tocsr()
    row, column = _cell(goal, resolution)
    _, then = dijkstra(graph, directed=False, indices=row * columns + column, return_predecessors=True)
    return np.asarray(then, np.int32)


def _moved(free: NDArray[np.bool_], move: tuple[int, int]) -> NDArray[np.bool_]:
    """Return whether the cell that lies a move away from each cell is free."""
    rows, columns = free.shape
    padded = np.pad(free, 2)
    return padded[2 + move[0] : 2 + move[0] + rows, 2 + move[1] : 2 + move[1] + columns]


def _sees(real: Cells, place: tuple[int, int], leaf: Leaf, resolution: float) -> bool:
    """Return whether a lidar in a cell sees any cell of a closed door."""
    rows, columns = (side.ravel() for side in np.mgrid[leaf])
    distance = np.hypot(rows - place[0], columns - place[1]) * resolution
    share = np.linspace(0.0, 1.0, 4 * max(real.shape))
    for row, column in np.column_stack((rows, columns))[distance < _ROBOT.lidar.spec.range.high].tolist():
        along = np.rint(place[0] + share * (row - place[0])).astype(int)
        beside = np.rint(place[1] + share * (column - place[1])).astype(int)
        hit = np.flatnonzero(real[along, beside] != 0)
        if len(hit) and (along[hit[0]], beside[hit[0]]) == (row, column):
            return True
    return False
