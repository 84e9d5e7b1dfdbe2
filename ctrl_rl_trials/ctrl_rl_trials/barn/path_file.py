"""The path that BARN's makers found through a world: its length is the measure of the score."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
from ctrl_rl_core.io import FileError, raise_as, read_bytes
from numpy.typing import NDArray

from ctrl_rl_trials.errors import TrialError

_LARGEST = 1e6
_MOST_CELLS = 10_000
_CELL = 0.15
_ORIGIN = (-4.575, 5.075)
"""Cell (i, j) of a path lies at _ORIGIN + _CELL (i, j) in the world [m] (function path_coord_to_gazebo_coord)."""


def read_path(path: Path) -> NDArray[np.float64]:
    """Return the places (n, 2) of a path file in the world [m].

    Raises:
        TrialError: The file is missing, or holds no list of cells.
    """
    with raise_as(TrialError, path):
        content = read_bytes(path, _LARGEST)
        try:
            cells = np.lib.format.read_array(BytesIO(content), allow_pickle=False)
        except (ValueError, EOFError, OverflowError, MemoryError):
            raise FileError("is no NumPy array of numbers") from None
        if (
            cells.ndim != 2
            or cells.shape[1] != 2
            or not 2 <= len(cells) <= _MOST_CELLS
            or cells.dtype.kind not in "iuf"
        ):
            raise FileError("must hold the cells of a path, two numbers each")
        cells = cells.astype(float)
        if not (np.abs(cells) <= _MOST_CELLS).all():
            raise FileError(f"has a cell beyond {_MOST_CELLS}, or one that is not finite")
        return np.asarray(_ORIGIN + _CELL * cells, float)
