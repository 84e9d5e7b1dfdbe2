"""Floors of rooms with doors, some of which are closed in the world and open on the map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from closed_doors.best import Best, plan
from ctrl_rl_core import OccupancyMap

RESOLUTION = 0.05
_WALL = 2
"""Thickness of walls [cells]."""
_ROOMS = ((2, 3), (2, 2))
"""Least and largest number of rooms along x and along y."""
_SIZE, _DOOR = (2.5, 4.0), (0.5, 0.9)
"""Sides of rooms and widths of doors [m]."""
_SHARE = 0.4
"""Share of the doors that are closed."""
_FAR = 3.0
"""Least distance between start and goal [m]."""
_COST = 1.1
"""Least ratio of the best time to that with all doors open."""
_OCCUPIED = 100

Cells = NDArray[np.int8]


class Door(NamedTuple):
    """The cells of a door, and whether it is closed in the world."""

    rows: slice
    columns: slice
    closed: bool


@dataclass(frozen=True)
class World:
    """A floor, and a drive on it.

    Attributes:
        known: Cells of the map, on which all doors are open.
        doors: Its doors.
        start: Pose at the start [m, m, rad].
        goal: Position of the goal [m].
    """

    known: Cells
    doors: tuple[Door, ...]
    start: tuple[float, float, float]
    goal: tuple[float, float]

    @property
    def real(self) -> Cells:
        """Cells of the world."""
        cells = self.known.copy()
        for door in self.doors:
            if door.closed:
                cells[door.rows, door.columns] = _OCCUPIED
        return cells

    def map_of(self, cells: Cells) -> OccupancyMap:
        """Return cells as a map."""
        return OccupancyMap(cells, RESOLUTION)

    def best(self) -> Best:
        """Return what the best robot does that has the map and learns by sight which doors are closed."""
        closed = [(door.rows, door.columns) for door in self.doors if door.closed]
        return plan(self.known, closed, self.start[:2], self.goal, RESOLUTION)


def draw_world(seed: int, shut: bool = False) -> tuple[World, Best]:
    """Return a floor on whose shortest way a door is closed, and the best drive there.

    Args:
        seed: Seed of rooms, doors, start and goal.
        shut: Whether every door of the goal's room is closed; else there is a way round.
    """
    random = np.random.default_rng((seed, int(shut)))
    while True:
        known, doors, rooms = _floor(random)
        one, other = random.choice(len(rooms), 2, replace=False)
        start, goal = _place(random, rooms[one]), _place(random, rooms[other])
        if math.dist(start, goal) < _FAR:
            continue
        if shut:
            doors = tuple(door._replace(closed=door.closed or _touches(door, rooms[other])) for door in doors)
        world = World(known, doors, (*start, float(random.uniform(-math.pi, math.pi))), goal)
        best = world.best()
        promised = replace(world, doors=()).best()
        if math.isinf(best.seconds) if shut else _COST * promised.seconds < best.seconds < math.inf:
            return world, best


Room = tuple[slice, slice]


def _floor(random: np.random.Generator) -> tuple[Cells, tuple[Door, ...], list[Room]]:
    """Draw rooms in rows and columns, and one or two doors in each wall between two of them."""
    across, up = (int(random.integers(low, high + 1)) for low, high in _ROOMS)
    xs, ys = _cuts(random, across), _cuts(random, up)
    cells = np.full((ys[-1] + _WALL, xs[-1] + _WALL), _OCCUPIED, np.int8)
    rooms = [(slice(b + _WALL, t), slice(a + _WALL, z)) for b, t in pairwise(ys) for a, z in pairwise(xs)]
    for room in rooms:
        cells[room] = 0
    doors: list[Door] = []
    for (low, high), wall in product(pairwise(xs), ys[1:-1]):
        doors += [Door(slice(wall, wall + _WALL), gap, _shut(random)) for gap in _gaps(random, low, high)]
    for (low, high), wall in product(pairwise(ys), xs[1:-1]):
        doors += [Door(gap, slice(wall, wall + _WALL), _shut(random)) for gap in _gaps(random, low, high)]
    for door in doors:
        cells[door.rows, door.columns] = 0
    return cells, tuple(doors), rooms


def _shut(random: np.random.Generator) -> bool:
    return bool(random.random() < _SHARE)


def _cuts(random: np.random.Generator, count: int) -> list[int]:
    """Draw where walls begin [cells]."""
    sizes = np.rint(random.uniform(*_SIZE, count) / RESOLUTION).astype(int)
    return [0, *np.cumsum(sizes + _WALL).tolist()]


def _gaps(random: np.random.Generator, low: int, high: int) -> list[slice]:
    """Draw one or two doors in a wall between two corners [cells], well apart."""
    count = int(random.integers(1, 3))
    edges = np.linspace(low + 2 * _WALL, high - _WALL, count + 1)
    out = []
    for begin, end in pairwise(edges.tolist()):
        width = round(random.uniform(*_DOOR) / RESOLUTION)
        first = int(random.integers(math.ceil(begin), math.floor(end) - width))
        out.append(slice(first, first + width))
    return out


def _place(random: np.random.Generator, room: Room) -> tuple[float, float]:
    """Draw a place in a room, away from its walls [m]."""
    rows, columns = ((side.start * RESOLUTION + 0.4, side.stop * RESOLUTION - 0.4) for side in room)
    return float(random.uniform(*columns)), float(random.uniform(*rows))


def _touches(door: Door, room: Room) -> bool:
    """Return whether a door leads into a room."""
    return all(
        side.start <= wall.stop and wall.start <= side.stop
        for wall, side in zip((door.rows, door.columns), room, strict=True)
    )
