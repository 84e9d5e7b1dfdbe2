"""The room around a car's rectangle at each state of a grid: its distance to the nearest obstacle.

The distance field is sampled around the rectangle's edge. No obstacle lies nearer to a point than the field says, so
the next sample is as far ahead as the field exceeds the least distance found: away from obstacles a few samples do.
"""

from __future__ import annotations

import math
from typing import Any

from ctrl_rl_core.values import cached_njit
from numba import njit

from ctrl_rl_navigation.cars.footprint import distance
from ctrl_rl_navigation.cars.tiles import COLUMNS, ROWS

_FINEST = 0.7
"""Minimum distance between two samples [cells]."""


@njit
def _room_at(field: Any, row: float, column: float, theta: float, footprint: Any, most: float) -> float:
    """Return the distance from the rectangle to the nearest obstacle, up to a limit; 0 if they overlap [cells]."""
    c, s = math.cos(theta), math.sin(theta)
    centre, half_length, half_width = footprint
    middle_row, middle_column = row + s * centre, column + c * centre
    reach = max(half_length - half_width, 0.0)
    at = -reach
    while at <= reach:  # an obstacle in the middle is nearer to this line than the edge
        if distance(field, middle_row + s * at, middle_column + c * at) < half_width:
            return 0.0
        at += 0.5 * half_width
    least = most
    halves = (half_length, half_width)
    for side in range(4):
        half, away = halves[side % 2], halves[1 - side % 2]
        along_x, along_y = (0, 1, 0, -1)[(side + 1) % 4], (0, 1, 0, -1)[side]
        at = -half
        while at <= half:
            x, y = at * along_x + away * along_y, at * along_y - away * along_x
            found = distance(field, middle_row + s * x + c * y, middle_column + c * x - s * y)
            least = min(least, found)
            if least <= 0.0:
                return 0.0
            at += max(found - least, _FINEST)
    return least


def _fill_room(
    field: Any, footprint: Any, scale: float, offset: float, border: int, most: float, unit: float, tiles: Any, out: Any
) -> None:
    """Fill in the room of the states of tiles.

    Args:
        field: Distances from the map's cells to the nearest obstacle (rows, columns) [cells].
        footprint: The rectangle without a margin, in the map's cells.
        scale: Length of a cell of the grid in cells of the map.
        offset: Position of the grid's first cell on the map [cells].
        border: Width of the border around the grid in `out`.
        most: Largest room that matters [cells of the map].
        unit: Length of a cell of the map [m].
        tiles: First row and column of each tile (n, 2).
        out: Room (headings, rows, columns) [m].
    """
    headings = len(out)
    centre, half_length, half_width = footprint
    near = min(half_width, half_length - centre)
    far = math.hypot(centre + half_length, half_width) + most
    for number in range(len(tiles)):
        for i in range(tiles[number, 0], tiles[number, 0] + ROWS):
            for j in range(tiles[number, 1], tiles[number, 1] + COLUMNS):
                row, column = offset + scale * (i - border), offset + scale * (j - border)
                away = distance(field, row, column)
                for k in range(headings):
                    room = most if away >= far else 0.0
                    if near < away < far:
                        room = _room_at(field, row, column, 2.0 * math.pi * k / headings, footprint, most)
                    out[k, i, j] = room * unit


fill_room = cached_njit(_fill_room, nogil=True)
