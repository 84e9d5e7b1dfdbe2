"""Generator of the shipped maps: `python ctrl_rl_navigation/test/generated_maps.py FOLDER`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

RESOLUTION = 0.05
_OCCUPIED = 100

Cells = NDArray[np.int8]


def maze(seed: int = 3, rooms: tuple[int, int] = (9, 7), width: int = 16, wall: int = 2) -> Cells:
    """Generate a maze with few loops: passages of 0.8 m between walls of 0.1 m.

    Args:
        seed: Random seed of the passages.
        rooms: Number of cells of the maze along x and y.
        width: Width of a passage [map cells].
        wall: Thickness of a wall [map cells].
    """
    random = np.random.default_rng(seed)
    across, up = rooms
    pitch = width + wall
    cells = np.full((up * pitch + wall, across * pitch + wall), _OCCUPIED, np.int8)
    for row in range(up):
        for column in range(across):
            cells[wall + row * pitch :, wall + column * pitch :][:width, :width] = 0
    seen, stack = {(0, 0)}, [(0, 0)]
    while stack:
        row, column = stack[-1]
        steps = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
        free = [(r, c) for r, c in steps if 0 <= r < up and 0 <= c < across and (r, c) not in seen]
        if not free:
            stack.pop()
            continue
        step = free[random.integers(len(free))]
        _open(cells, (row, column), step, width, wall)
        seen.add(step)
        stack.append(step)
    for _ in range(across * up // 12):
        row, column = int(random.integers(up)), int(random.integers(across - 1))
        _open(cells, (row, column), (row, column + 1), width, wall)
    return cells


def _open(cells: Cells, one: tuple[int, int], other: tuple[int, int], width: int, wall: int) -> None:
    """Remove the wall between two adjacent cells of a maze."""
    pitch = width + wall
    bottom, top = sorted((one[0], other[0]))
    left, right = sorted((one[1], other[1]))
    rows = slice(wall + bottom * pitch, wall + top * pitch + width)
    cells[rows, wall + left * pitch : wall + right * pitch + width] = 0


def warehouse(seed: int = 5, size: tuple[int, int] = (240, 180)) -> Cells:
    """Generate a hall of 12 m by 9 m with rows of shelves, aisles of 0.8 to 1.2 m, and scattered pallets.

    Args:
        seed: Random seed of aisles and pallets.
        size: Number of map cells along x and y.
    """
    random = np.random.default_rng(seed)
    columns, rows = size
    cells = np.zeros((rows, columns), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = (_OCCUPIED,) * 4
    row = 24
    while row + 12 < rows - 20:
        gap = int(random.integers(40, columns - 60))
        for begin, end in ((26, gap), (gap + 20, columns - 26)):
            cells[row : row + 10, begin:end] = _OCCUPIED
        row += 10 + int(random.integers(16, 25))
    for _ in range(60):
        left, bottom = int(random.integers(24, columns - 40)), int(random.integers(4, rows - 14))
        around = cells[max(bottom - 14, 2) : bottom + 24, max(left - 14, 2) : left + 24]
        if not around.any():
            cells[bottom : bottom + 10, left : left + 10] = _OCCUPIED
    return cells


def corridor(seed: int = 1, length: int = 300, width: int = 24) -> Cells:
    """Generate a corridor of 15 m by 1.2 m with two bends, and rooms behind doors of 0.6 m.

    Args:
        seed: Random seed of the doors.
        length: Length of the corridor [cells].
        width: Width of the corridor [cells].
    """
    random = np.random.default_rng(seed)
    depth, wall = 50, 2
    cells = np.full((2 * depth + 2 * width + 8, length + 2 * wall), _OCCUPIED, np.int8)
    middle = length // 2
    low, high = depth + 2 * wall, depth + 2 * wall + width
    cells[low : low + width, wall : middle + width] = 0
    cells[high : high + width, middle : wall + length] = 0
    for left in range(wall, middle - 60, 62):
        _room(cells, (wall, low - wall), (left, left + 60), low - wall, random)
    for left in range(middle + 2, length - 58, 62):
        _room(cells, (high + width + wall, cells.shape[0] - wall), (left, left + 60), high + width, random)
    return cells


def _room(
    cells: Cells, rows: tuple[int, int], columns: tuple[int, int], wall: int, random: np.random.Generator
) -> None:
    """Clear a room with a table, and a door of 0.6 m through the wall that starts at row `wall`."""
    cells[rows[0] : rows[1], columns[0] : columns[1]] = 0
    door = int(random.integers(columns[0] + 4, columns[1] - 16))
    cells[wall : wall + 2, door : door + 12] = 0
    row, column = (int(random.integers(low + 16, high - 24)) for low, high in (rows, columns))
    cells[row : row + 8, column : column + 8] = _OCCUPIED


MAPS: Mapping[str, Callable[[], Cells]] = {"maze": maze, "warehouse": warehouse, "corridor": corridor}


def make_map(name: str) -> OccupancyMap:
    """Generate a map of `MAPS` by name."""
    return OccupancyMap(MAPS[name](), RESOLUTION)


def main() -> int:
    """Write all maps to a folder."""
    folder = Path(sys.argv[1])
    for name in MAPS:
        make_map(name).save(folder / f"{name}.yaml")
    return 0


if __name__ == "__main__":
    sys.exit(main())
