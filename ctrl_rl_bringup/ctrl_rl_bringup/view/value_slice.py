"""A slice of a value file at the robot's heading, as a surface."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from ctrl_rl_core.values import plane_of

from ctrl_rl_bringup.view.scene import Surface
from ctrl_rl_core import ValueGrid

_TURN = math.radians(15.0)
"""Change of heading from which on there is another slice [rad]."""
_MOST = 150
"""Number of rows and of columns of a slice."""


class ValueSlice:
    """Slices of a value grid; speeds and other components are 0.

    Args:
        path: File of the grid.

    Raises:
        CtrlRlError: The file cannot be read, or its states have no plane of positions.
    """

    def __init__(self, path: Path) -> None:
        self._grid = ValueGrid.load(path)
        self._plane = plane_of(self._grid)
        self._shown: tuple[int, Surface] | None = None

    def at(self, heading: float) -> Surface:
        """Return the slice at a heading [rad]; the same object until the robot has turned."""
        turns = round(heading / _TURN)
        if self._shown is None or self._shown[0] != turns:
            self._shown = turns, self._slice(turns * _TURN)
        return self._shown[1]

    def _slice(self, heading: float) -> Surface:
        first, second = self._plane.first, self._plane.second
        cell = max(axis.upper - axis.lower for axis in (first, second)) / (_MOST - 1)
        columns, rows = (int((axis.upper - axis.lower) / cell) + 1 for axis in (first, second))
        fixed = {"theta": heading} if "theta" in self._plane.others else {}
        across, along = (
            axis.lower + cell * np.arange(count, dtype=np.float64) for axis, count in ((first, columns), (second, rows))
        )
        values = self._grid.value(self._plane.states(across, along, fixed))
        values[~np.isfinite(values)] = np.nan
        if self._grid.kind != "time_to_reach":  # high returns and margins are good, long times are not
            values = -values
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        return Surface((values - low) / max(high - low, 1e-9), cell, (first.lower, second.lower, 0.0))
