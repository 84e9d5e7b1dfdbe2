"""The space around a robot that it has seen, so that unseen space can count as an obstacle.

The space is a grid of cells in a fixed frame. A cell is seen once a beam has passed through it or the robot has stood
on it. Space behind an edge, in a blind direction or beyond the lidar's range stays unseen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from ctrl_rl_core.sensing import DIRECTIONS, nearest_beams
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry

Array = NDArray[np.float64]

_CELL = 0.05
_BESIDE = 0.1
"""Radius around the robot at the first scan that is assumed to be free [m]; otherwise the robot could not turn."""
_BEARINGS = np.linspace(0.0, 2.0 * math.pi, DIRECTIONS, endpoint=False)


class Sight(NamedTuple):
    """Free range of a scan in each direction.

    Attributes:
        ways: Free distance in each direction, counter-clockwise from ahead (DIRECTIONS,) [m]; 0 in blind directions.
        forward: Position of the lidar ahead of the robot's centre [m].
    """

    ways: Array
    forward: float


def sight_of(ranges: NDArray[np.float32], scan: ScanGeometry, forward: float) -> Sight:
    """Return the free range of a scan in each direction.

    Args:
        ranges: Ranges (scan.beams,) [m]. By REP-117, +inf means free space up to the maximum range.
        scan: Bearings and limits of the beams in the robot's frame.
        forward: Position of the lidar ahead of the robot's centre [m].
    """
    field, nearest = nearest_beams(scan, _BEARINGS)
    ways = np.where(ranges >= scan.range_min, np.minimum(ranges, scan.range_max), 0.0)  # NaN is no measurement
    return Sight(np.where(field, ways[nearest], 0.0), forward)


class SeenSpace:
    """Cells around the robot, and whether they have been seen.

    Args:
        reach: Distance from the robot within which cells are kept [m].
        radius: Radius of the disc that encloses the robot [m].
    """

    def __init__(self, reach: float, radius: float) -> None:
        self._half = math.ceil(reach / _CELL)
        self._radius = radius
        side = 2 * self._half + 1
        self._seen = np.zeros((side, side), np.bool_)
        self._middle = np.zeros(2, np.intp)

    def update(self, pose: Array, sight: Sight) -> Array:
        """Add a scan and return the boundary points of unseen space (n, 2), in the frame of the pose [m].

        Args:
            pose: Pose of the robot at the time of the scan (3,) [m, m, rad].
            sight: Free range of the scan in each direction.
        """
        self._move_to(np.floor(pose[:2] / _CELL).astype(np.intp))
        offsets = np.arange(-self._half, self._half + 1)
        x, y = (self._middle[0] + offsets + 0.5) * _CELL, (self._middle[1] + offsets[:, None] + 0.5) * _CELL
        dx, dy = x - pose[0], y - pose[1]
        self._seen |= np.hypot(dx, dy) <= self._radius + (0.0 if self._seen.any() else _BESIDE)
        dx, dy = dx - sight.forward * math.cos(pose[2]), dy - sight.forward * math.sin(pose[2])
        bearing = np.arctan2(dy, dx) - pose[2]
        direction = np.rint(bearing * (DIRECTIONS / (2.0 * math.pi))).astype(np.intp) % DIRECTIONS
        self._seen |= np.hypot(dx, dy) < sight.ways[direction]
        inner = self._seen[1:-1, 1:-1]
        beside = self._seen[:-2, 1:-1] | self._seen[2:, 1:-1] | self._seen[1:-1, :-2] | self._seen[1:-1, 2:]
        rows, columns = np.nonzero(beside & ~inner)
        return np.column_stack((x[columns + 1], y[rows + 1, 0]))

    def clear(self) -> None:
        """Discard all cells, because the frame has jumped."""
        self._seen[:] = False

    def _move_to(self, middle: NDArray[np.intp]) -> None:
        """Move the window to another cell; newly covered cells are unseen."""
        columns, rows = (middle - self._middle).tolist()
        self._middle = middle
        side = len(self._seen)
        moved = np.zeros_like(self._seen)
        if abs(rows) < side and abs(columns) < side:
            to = [slice(max(0, -by), side + min(0, -by)) for by in (rows, columns)]
            source = [slice(max(0, by), side + min(0, by)) for by in (rows, columns)]
            moved[tuple(to)] = self._seen[tuple(source)]
        self._seen = moved
