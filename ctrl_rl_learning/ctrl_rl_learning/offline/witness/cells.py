"""Count for each cell of a grid how many beams end in it and how many pass through it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from numpy.typing import NDArray

from ctrl_rl_learning.offline.witness.beams import Beams

Array = NDArray[np.float64]
RESOLUTION = 0.05
"""Side length of a cell [m]."""
_MOST_CELLS = 2_000_000


@cached_njit
def _count_passes(starts: Any, directions: Any, lengths: Any, corner: Any, resolution: float, counts: Any) -> None:
    """Add 1 to each cell that a beam passes through; beams (M, 2), (M, 2), (M,), cells counted (rows, columns)."""
    rows, columns = counts.shape
    for beam in range(len(lengths)):
        last_row, last_column = -1, -1
        steps = int(lengths[beam] / (0.5 * resolution))
        for step in range(steps):
            far = (step + 0.5) * 0.5 * resolution
            row = int(np.floor((starts[beam, 1] + far * directions[beam, 1] - corner[1]) / resolution))
            column = int(np.floor((starts[beam, 0] + far * directions[beam, 0] - corner[0]) / resolution))
            if (row != last_row or column != last_column) and 0 <= row < rows and 0 <= column < columns:
                counts[row, column] += 1
            last_row, last_column = row, column


@dataclass(frozen=True)
class Cells:
    """A grid in the plane; row 0 is the lowest.

    Attributes:
        corner: Its lower left corner (2,) [m].
        resolution: Side length of a cell [m].
        shape: Rows and columns.
    """

    corner: Array
    resolution: float
    shape: tuple[int, int]

    @classmethod
    def around(cls, low: Array, high: Array, margin: float = 0.5, cell: float = RESOLUTION) -> Cells:
        """Return a grid over the rectangle from `low` to `high` (2,) [m]; its cells are larger in a very large one."""
        corner, size = low - margin, high - low + 2.0 * margin
        resolution = max(cell, float(np.sqrt(size.prod() / _MOST_CELLS)))
        columns, rows = np.ceil(size / resolution).astype(int).tolist()
        return cls(corner, resolution, (max(1, rows), max(1, columns)))

    @property
    def far_corner(self) -> Array:
        """Its upper right corner (2,) [m]."""
        return self.corner + self.resolution * np.array(self.shape[::-1])

    def index(self, points: Array) -> NDArray[np.intp]:
        """Return the flat index (n,) of the cells of points (n, 2) [m]; those outside count for the nearest cell."""
        cell = np.floor((points - self.corner) / self.resolution)
        columns, rows = np.clip(cell, 0, np.array(self.shape[::-1]) - 1).astype(np.intp).T
        return rows * self.shape[1] + columns

    def places(self, indices: NDArray[np.intp]) -> Array:
        """Return the middles (n, 2) [m] of cells by flat index (n,)."""
        rows, columns = np.divmod(indices, self.shape[1])
        return self.corner + (np.stack((columns, rows), axis=1) + 0.5) * self.resolution

    def count(self, points: Array) -> NDArray[np.int64]:
        """Return how many of points (n, 2) lie in each cell (rows, columns)."""
        return np.bincount(self.index(points), minlength=int(np.prod(self.shape))).reshape(self.shape)

    def passes(self, beams: Beams) -> NDArray[np.int64]:
        """Return how many beams passed through each cell (rows, columns): all but their last two cells' length."""
        counts = np.zeros(self.shape, dtype=np.int64)
        lengths = np.where(beams.echoes, beams.ranges - 1.5 * self.resolution, beams.ranges)
        _count_passes(beams.starts, beams.directions, lengths, self.corner, self.resolution, counts)
        return counts
