"""Distances to the echoes of a scan: on a small grid around the robot for quick answers, and exact ones.

A distance is 1-Lipschitz, so that the distance at the nearest node less the way to it is a lower bound. Where that
bound decides nothing, the echoes themselves are asked: the grid makes answers quicker, never larger.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values.jit_cache import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.growth import moving_growth, standing_growth

Array = NDArray[np.float64]

FAR = 1e3
"""Distance where there is no echo [m]."""
CAP = 0.04
"""Margins are exact up to here, and at least this much beyond [m]."""
NODES = 60
"""Nodes along each side of the grid."""


class Obstacles(NamedTuple):
    """Echoes in a frame that stands still, and their distances on a grid in it.

    Attributes:
        standing: Echoes of what is known to stand (2, n) [m].
        moving: Echoes that may belong to movers (2, m) [m].
        to_standing: Distance of each node to the nearest standing echo (rows, columns), along y and x [m].
        to_moving: Distance of each node to the nearest moving one (rows, columns) [m].
        x: Position of the first column [m].
        y: Position of the first row [m].
        cell: Distance of neighbouring nodes [m].
    """

    standing: Array
    moving: Array
    to_standing: NDArray[np.float32]
    to_moving: NDArray[np.float32]
    x: float
    y: float
    cell: float


@cached_njit
def _distances(points: Array, x: float, y: float, cell: float, nodes: int) -> Any:
    squares = np.full((nodes, nodes), np.float32(FAR * FAR))
    for i in range(points.shape[1]):
        along, aside = points[0, i] - x, points[1, i] - y
        for row in range(nodes):
            dy = aside - row * cell
            base = dy * dy
            for column in range(nodes):
                dx = along - column * cell
                square = np.float32(base + dx * dx)
                squares[row, column] = min(square, squares[row, column])
    return np.sqrt(squares)


def obstacles_around(standing: Array, moving: Array, centre: tuple[float, float], cell: float) -> Obstacles:
    """Return echoes (n, 2) and (m, 2) [m] with the distances on a grid around a place [m]."""
    x, y = (float(place) - 0.5 * (NODES - 1) * cell for place in centre)
    standing, moving = np.ascontiguousarray(standing.T), np.ascontiguousarray(moving.T)
    return Obstacles(
        standing, moving, _distances(standing, x, y, cell, NODES), _distances(moving, x, y, cell, NODES), x, y, cell
    )


@njit(fastmath=True)  # echoes are finite, and the order in which a minimum is taken does not matter
def _nearest(points: Any, x: float, y: float) -> float:
    least = FAR * FAR
    for i in range(points.shape[1]):
        dx, dy = points[0, i] - x, points[1, i] - y
        least = min(least, dx * dx + dy * dy)
    return math.sqrt(least)


@njit(inline="always")
def margin_at(obstacles: Any, growth: Any, x: float, y: float, t: float, rooms: tuple[float, float]) -> float:
    """Return the distance by which a disc keeps clear of all grown echoes [m]; at least `CAP` stands for more.

    Args:
        obstacles: Echoes with their grid.
        growth: Bounds of motion.
        x: Position of the disc [m].
        y: Position of the disc [m].
        t: Time since the echoes were measured [s].
        rooms: Radius that the disc needs beside standing echoes and beside moving ones [m].
    """
    stands, moves = rooms[0] + standing_growth(t, growth), rooms[1] + moving_growth(t, growth)
    nodes = obstacles.to_standing.shape[0]
    column, row = (x - obstacles.x) / obstacles.cell, (y - obstacles.y) / obstacles.cell
    j, i = math.floor(column + 0.5), math.floor(row + 0.5)
    near_standing = near_moving = -FAR
    if 0 <= i < nodes and 0 <= j < nodes:
        away = math.hypot(column - j, row - i) * obstacles.cell
        near_standing = obstacles.to_standing[i, j] - away - stands
        near_moving = obstacles.to_moving[i, j] - away - moves
    if near_standing < CAP:
        near_standing = _nearest(obstacles.standing, x, y) - stands
    if near_moving < CAP:
        near_moving = _nearest(obstacles.moving, x, y) - moves
    return min(near_standing, near_moving)
