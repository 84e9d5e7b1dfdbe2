"""Maps for cars: an office as recorded, a maze, and a car park with narrow bays."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

OFFICE = Path("../shared/data/tb4_office/mac_1st_floor_final.yaml")
"""Map of an office of 27 m by 51 m, beside the repository; not part of it."""
OCCUPIED = 100
_BAY, _DEPTH, _AISLE = 2.2, 5.0, 6.5
"""Width and depth of a bay, and width of an aisle [m]."""
_PARKED = (1.75, 4.4)
"""Width and length of a parked car [m]."""

Cells = NDArray[np.int8]


@dataclass(frozen=True)
class Place:
    """A map with its car.

    Attributes:
        name: Name of the map.
        robot: Name of the car.
        map: The map.
        bays: Poses of the middle of a car in each empty bay (n, 3) [m, m, rad]; it may also stand the other way.
    """

    name: str
    robot: str
    map: OccupancyMap
    bays: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))


def make_place(name: str, seed: int) -> Place | None:
    """Return a map by name, None if its data are absent.

    Raises:
        ValueError: There is no such map.
    """
    random = np.random.default_rng((seed, 21))
    if name == "office":
        file = Path(__file__).parents[2] / OFFICE
        return Place(name, "race_car", OccupancyMap.load(file)) if file.exists() else None
    if name == "maze":
        return Place(name, "race_car", make_maze(random))
    if name == "parking":
        return Place(name, "road_car", *make_car_park(random))
    raise ValueError(f"there is no map '{name}'")


def make_maze(
    random: np.random.Generator, rows: int = 9, columns: int = 9, corridor: float = 1.3, resolution: float = 0.05
) -> OccupancyMap:
    """Return a maze of square rooms, each joined to the others by one way, and some walls removed for further ways."""
    pitch, wall = round(corridor / resolution) + 2, 2
    cells = np.full((rows * pitch + wall, columns * pitch + wall), OCCUPIED, np.int8)
    seen, stack = {(0, 0)}, [(0, 0)]
    doors = []
    while stack:
        i, j = stack[-1]
        beside = [(i + a, j + b) for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        new = [(a, b) for a, b in beside if 0 <= a < rows and 0 <= b < columns and (a, b) not in seen]
        if not new:
            stack.pop()
            continue
        to = new[random.integers(len(new))]
        seen.add(to)
        stack.append(to)
        doors.append(((i, j), to))
    for _ in range(rows * columns // 6):
        i, j = int(random.integers(rows - 1)), int(random.integers(columns - 1))
        doors.append(((i, j), (i + 1, j) if random.random() < 0.5 else (i, j + 1)))
    for i in range(rows):
        for j in range(columns):
            cells[i * pitch + wall : (i + 1) * pitch, j * pitch + wall : (j + 1) * pitch] = 0
    for (i, j), (a, b) in doors:
        low, left, high, right = min(i, a), min(j, b), max(i, a), max(j, b)
        cells[low * pitch + wall : (high + 1) * pitch, left * pitch + wall : (right + 1) * pitch] = 0
    return OccupancyMap(cells, resolution)


def make_car_park(
    random: np.random.Generator, bays: int = 17, rows: int = 3, taken: float = 0.6, resolution: float = 0.1
) -> tuple[OccupancyMap, NDArray[np.float64]]:
    """Return a car park and the poses in its empty bays, see `Place`.

    It is about 51 m by 28 m: rows of bays along aisles, most of them taken, joined at both ends.
    """
    empty = []
    width, end = bays * _BAY + 2.0 * _AISLE, 0.2
    pairs, odd = divmod(rows, 2)
    height = pairs * (2.0 * _DEPTH + _AISLE) + odd * (_DEPTH + _AISLE) + 2.0 * end
    shape = (round(height / resolution), round(width / resolution))
    cells = np.zeros(shape, np.int8)
    cells[[0, 1, -2, -1]], cells[:, [0, 1, -2, -1]] = OCCUPIED, OCCUPIED
    for row in range(rows):
        pair, upper = divmod(row, 2)
        bottom = end + pair * (2.0 * _DEPTH + _AISLE) + upper * (_DEPTH + _AISLE)
        for bay in range(bays):
            left = _AISLE + bay * _BAY
            if random.random() < taken:
                x = left + 0.5 * (_BAY - _PARKED[0]) + random.uniform(-0.1, 0.1)
                y = bottom + 0.5 * (_DEPTH - _PARKED[1]) + random.uniform(-0.2, 0.2)
                _fill(cells, resolution, x, y, *_PARKED)
            else:
                empty.append((left + 0.5 * _BAY, bottom + 0.5 * _DEPTH, 0.5 * np.pi))
        if upper and row + 1 < rows:  # a kerb between rows that stand back to back
            _fill(cells, resolution, _AISLE, bottom + _DEPTH - 0.1, bays * _BAY, 0.2)
    return OccupancyMap(cells, resolution), np.array(empty)


def _fill(cells: Cells, resolution: float, x: float, y: float, width: float, height: float) -> None:
    """Occupy a rectangle given by its lower left corner and sides [m]."""
    rows = slice(round(y / resolution), round((y + height) / resolution))
    cells[rows, round(x / resolution) : round((x + width) / resolution)] = OCCUPIED
