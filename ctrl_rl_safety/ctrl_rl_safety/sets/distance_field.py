"""Distances to the echoes of a scan: approximate ones on a small grid around the robot, and exact ones.

Distance is 1-Lipschitz, so the distance at the nearest node minus the distance to that node is a lower bound. If that
bound is inconclusive, the echoes themselves are used, so the grid speeds up answers without changing them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.growth import fixed_growth, moving_growth, standing_growth

Array = NDArray[np.float64]

FAR = 1e3
"""Distance in place of an echo if there is none [m]."""
CAP = 0.04
"""Margins are exact up to this value, and at least this value beyond [m]."""
NODES = 60
"""Number of nodes along each side of the grid."""
NONE: Array = np.empty((0, 2))
"""Array of no echoes."""


class Obstacles(NamedTuple):
    """Echoes in a fixed frame, and their distances on a grid in that frame.

    Attributes:
        fixed: Echoes of fixed obstacles (2, k) [m].
        standing: Echoes of static obstacles (2, n) [m].
        moving: Echoes that may belong to movers (2, m) [m].
        to_fixed: Distance of each node to the nearest fixed echo (rows, columns), along y and x [m].
        to_standing: Distance of each node to the nearest static echo (rows, columns) [m].
        to_moving: Distance of each node to the nearest moving echo (rows, columns) [m].
        x: Position of the first column [m].
        y: Position of the first row [m].
        cell: Node spacing [m].
    """

    fixed: Array
    standing: Array
    moving: Array
    to_fixed: NDArray[np.float32]
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


def obstacles_around(
    fixed: Array, standing: Array, moving: Array, centre: tuple[float, float], cell: float
) -> Obstacles:
    """Create obstacles from echoes (k, 2), (n, 2) and (m, 2) [m], with distances on a grid around a position [m]."""
    x, y = (float(place) - 0.5 * (NODES - 1) * cell for place in centre)
    stays, stands, moves = (np.ascontiguousarray(each.T) for each in (fixed, standing, moving))
    to_stays, to_stands, to_moves = (_distances(each, x, y, cell, NODES) for each in (stays, stands, moves))
    return Obstacles(stays, stands, moves, to_stays, to_stands, to_moves, x, y, cell)


@njit(fastmath=True)  # echoes are finite, and the order of evaluating a minimum is irrelevant
def _nearest(points: Any, x: float, y: float) -> float:
    least = FAR * FAR
    for i in range(points.shape[1]):
        dx, dy = points[0, i] - x, points[1, i] - y
        least = min(least, dx * dx + dy * dy)
    return math.sqrt(least)


@njit(inline="always")
def square_to(points: Any, i: int, x: float, y: float, c: float, s: float, core: tuple[float, float]) -> float:
    """Return the squared distance of an echo to the core of a robot whose heading has cosine c and sine s [m^2]."""
    dx, dy = points[0, i] - x, points[1, i] - y
    along = max(abs(c * dx + s * dy) - core[0], 0.0)
    aside = max(abs(c * dy - s * dx) - core[1], 0.0)
    return along * along + aside * aside


@njit(fastmath=True)
def _nearest_to_rectangle(points: Any, x: float, y: float, theta: float, core: tuple[float, float]) -> float:
    c, s = math.cos(theta), math.sin(theta)
    least = FAR * FAR
    for i in range(points.shape[1]):
        least = min(least, square_to(points, i, x, y, c, s, core))
    return math.sqrt(least)


@njit
def distance_to(points: Any, x: float, y: float, theta: float, core: tuple[float, float]) -> float:
    """Return the distance from the nearest echo (2, n) to a robot's core [m]: a rectangle, or a disc's centre."""
    if core[0] > 0.0:
        return _nearest_to_rectangle(points, x, y, theta, core)
    return _nearest(points, x, y)


@njit
def margin_at(
    obstacles: Any,
    growth: Any,
    core: tuple[float, float],
    x: float,
    y: float,
    theta: float,
    t: float,
    rooms: tuple[float, float],
) -> float:
    """Return a robot's clearance to all inflated echoes [m]; values of at least `CAP` are lower bounds.

    Args:
        obstacles: Echoes with their grid.
        growth: Bounds of motion.
        core: Half the length and width of the robot's rectangle [m]; zeros for a disc.
        x: Coordinate x of the robot's centre [m].
        y: Coordinate y of the robot's centre [m].
        theta: Heading of the rectangle [rad].
        t: Time since the echoes were measured [s].
        rooms: Required distance of the core to static and to moving echoes [m].
    """
    stays, stands = rooms[0] + fixed_growth(t, growth), rooms[0] + standing_growth(t, growth)
    moves = rooms[1] + moving_growth(t, growth)
    nodes = obstacles.to_standing.shape[0]
    column, row = (x - obstacles.x) / obstacles.cell, (y - obstacles.y) / obstacles.cell
    j, i = math.floor(column + 0.5), math.floor(row + 0.5)
    near_fixed = near_standing = near_moving = -FAR
    if 0 <= i < nodes and 0 <= j < nodes:
        away = math.hypot(column - j, row - i) * obstacles.cell + math.hypot(core[0], core[1])
        near_fixed = obstacles.to_fixed[i, j] - away - stays
        near_standing = obstacles.to_standing[i, j] - away - stands
        near_moving = obstacles.to_moving[i, j] - away - moves
    if near_fixed < CAP:
        near_fixed = distance_to(obstacles.fixed, x, y, theta, core) - stays
    if near_standing < CAP:
        near_standing = distance_to(obstacles.standing, x, y, theta, core) - stands
    if near_moving < CAP:
        near_moving = distance_to(obstacles.moving, x, y, theta, core) - moves
    return min(near_fixed, near_standing, near_moving)
