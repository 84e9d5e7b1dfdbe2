"""Tiles of a grid, and their distribution to threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ROWS, COLUMNS = 16, 32
"""Rows and columns of a tile."""
_MOST_THREADS = 8
Places = NDArray[np.int64]
Share = Callable[[Callable[[Places], None], Places], None]
"""Calls a function with parts of places (n, ...), one for each thread."""


class Tiling(NamedTuple):
    """A grid in tiles, with a border around it.

    Attributes:
        rows: Number of tiles above each other.
        columns: Number of tiles beside each other.
        border: Width of the border [cells].
    """

    rows: int
    columns: int
    border: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of cells, with the border."""
        return self.rows * ROWS + 2 * self.border, self.columns * COLUMNS + 2 * self.border

    def corners(self, tiles: NDArray[np.bool_]) -> Places:
        """Return the first row and column of the marked tiles (n, 2)."""
        return np.argwhere(tiles) * (ROWS, COLUMNS) + self.border

    def any(self, states: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which tiles have a state that is marked (headings, rows, columns)."""
        border = self.border
        cells = np.logical_or.reduce(states)[border:-border, border:-border]
        out: NDArray[np.bool_] = cells.reshape(self.rows, ROWS, self.columns, COLUMNS).any(axis=(1, 3))
        return out

    def around(self, rows: Places, columns: Places, away: float) -> NDArray[np.bool_]:
        """Return which tiles may have a cell within a distance of cells, given by their rows and columns (n,)."""
        out = np.zeros((self.rows, self.columns), np.bool_)
        reach = math.ceil(away)
        for i, j in np.unique(np.column_stack((rows // ROWS, columns // COLUMNS)), axis=0).tolist():
            up, left = max(i - 1 - reach // ROWS, 0), max(j - 1 - reach // COLUMNS, 0)
            out[up : i + 2 + reach // ROWS, left : j + 2 + reach // COLUMNS] = True
        return out


def tiling_of(shape: tuple[int, int], border: int) -> Tiling:
    """Return the tiling of a grid with this many rows and columns of cells."""
    return Tiling(-(-shape[0] // ROWS), -(-shape[1] // COLUMNS), border)


@contextmanager
def sharing() -> Iterator[Share]:
    """Return what distributes tiles to as many threads as there are cores."""
    threads = min(len(os.sched_getaffinity(0)), _MOST_THREADS)
    with ThreadPoolExecutor(threads) as pool:

        def share(work: Callable[[Places], None], places: Places) -> None:
            list(pool.map(work, [places[first::threads] for first in range(threads)]))

        yield share
