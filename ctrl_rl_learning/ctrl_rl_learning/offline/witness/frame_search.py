"""Where recorded poses lie in a file's frame, however far off: the ends of all beams laid over the file's walls."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter

from ctrl_rl_learning.offline.witness.beams import FileWalls, compare
from ctrl_rl_learning.offline.witness.cells import Cells
from ctrl_rl_learning.offline.witness.offset import Offset, fit_offset
from ctrl_rl_learning.offline.witness.record import Sightings

Array = NDArray[np.float64]
_CELL, _MARGIN = 0.2, 0.5
"""Side length of a cell, and width of the rim around the walls [m]."""
_TURN = math.radians(4.0)
"""Step of the turns that are tried [rad]."""
_MOST_HITS = 5
"""Ends in a cell that count: a wall close to the lidar is hit by many beams."""


def find_offset(seen: Sequence[Sightings], walls: FileWalls) -> Offset:
    """Return the shift and turn by which scans fit a file's walls best: near none, or where a search finds one.

    Args:
        seen: Scans.
        walls: Walls of the file.
    """
    begins = (None, _search(seen, walls))
    found = [fit_offset(seen, walls, begin) for begin in begins]
    return min(found, key=lambda offset: compare([offset.moved(each) for each in seen], walls).differing)


def _search(seen: Sequence[Sightings], walls: FileWalls) -> Offset:
    """Return the shift and turn of poses after which most ends of beams lie at walls, to a cell and a step of turns."""
    beams = compare(seen, walls)
    ends = beams.ends[beams.echoes]
    about = ends.mean(axis=0)
    sides = walls.task.plane_bounds.values()
    grid = Cells.around(np.array([side.low for side in sides]), np.array([side.high for side in sides]), _MARGIN, _CELL)
    places = grid.places(np.arange(np.prod(grid.shape)))
    near = walls.task.build_world().signed_distance(places).reshape(grid.shape) < 0.5 * grid.resolution
    half = math.ceil(float(np.abs(ends - about).max()) * math.sqrt(2.0) / grid.resolution)
    shape = [next_fast_len(size + 2 * half, real=True) for size in grid.shape]
    there = rfft2(gaussian_filter(near.astype(np.float64), 0.5), shape)
    own = Cells(np.full(2, -half * grid.resolution), grid.resolution, (2 * half, 2 * half))
    best = (-1.0, 0.0, 0, 0)
    for turn in np.arange(-math.pi, math.pi, _TURN).tolist():
        turned = Offset((0.0, 0.0), turn, (0.0, 0.0)).places(ends - about)
        hits = np.minimum(own.count(turned), _MOST_HITS)
        score = irfft2(there * np.conj(rfft2(hits, shape)), shape) / hits.sum()
        row, column = np.unravel_index(int(score.argmax()), score.shape)
        best = max(best, (float(score[row, column]), turn, int(row), int(column)))
    _, turn, *cells = best
    rows, columns = (cell - size if cell > size - 2 * half else cell for cell, size in zip(cells, shape, strict=True))
    middle = grid.corner + (np.array((columns, rows)) + half) * grid.resolution
    shift = (middle - about).tolist()
    return Offset((shift[0], shift[1]), turn, (float(about[0]), float(about[1])))
