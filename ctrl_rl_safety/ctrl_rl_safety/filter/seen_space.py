"""The space around a robot that it has seen, so that what it has not can count as an obstacle.

The space is kept in cells that stand still. A cell is seen once a beam went through it, or the robot stood on it. What
lies behind an edge, in a blind direction or beyond the range of the lidar, was never seen.
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
"""Distance around the robot at the first scan within which nothing unseen is looked for [m]: it could not turn else."""
_BEARINGS = np.linspace(0.0, 2.0 * math.pi, DIRECTIONS, endpoint=False)


class Sight(NamedTuple):
    """How far a scan sees.

    Attributes:
        ways: Free way in each direction, counter-clockwise from ahead (DIRECTIONS,) [m]; 0 where it is blind.
        forward: Position of the lidar ahead of the robot's middle [m].
    """

    ways: Array
    forward: float


def sight_of(ranges: NDArray[np.float32], scan: ScanGeometry, forward: float) -> Sight:
    """Return how far a scan sees.

    Args:
        ranges: Ranges (scan.beams,) [m]. By REP-117 +inf sees nothing up to the largest range.
        scan: Bearings and limits of the beams in the robot's frame.
        forward: Position of the lidar ahead of the robot's middle [m].
    """
    field, nearest = nearest_beams(scan, _BEARINGS)
    ways = np.where(ranges >= scan.range_min, np.minimum(ranges, scan.range_max), 0.0)  # NaN is no measurement
    return Sight(np.where(field, ways[nearest], 0.0), forward)


class SeenSpace:
    """Cells within some distance of the robot, and whether they were seen.

    Args:
        reach: Distance from the robot up to which cells matter [m].
        radius: Radius of the disc that holds the robot [m].
    """

    def __init__(self, reach: float, radius: float) -> None:
        self._half = math.ceil(reach / _CELL)
        self._radius = radius
        side = 2 * self._half + 1
        self._seen = np.zeros((side, side), np.bool_)
        self._middle = np.zeros(2, np.intp)

    def update(self, pose: Array, sight: Sight) -> Array:
        """Take a scan and return the edges of what was never seen (n, 2), in the frame of the pose [m].

        Args:
            pose: Pose of the robot when the scan was taken (3,) [m, m, rad].
            sight: Reach of the scan in each direction.
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
        """Forget all, as the frame has jumped."""
        self._seen[:] = False

    def _move_to(self, middle: NDArray[np.intp]) -> None:
        """Move the window to another cell; what comes into it was not seen."""
        columns, rows = (middle - self._middle).tolist()
        self._middle = middle
        side = len(self._seen)
        moved = np.zeros_like(self._seen)
        if abs(rows) < side and abs(columns) < side:
            to = [slice(max(0, -by), side + min(0, -by)) for by in (rows, columns)]
            source = [slice(max(0, by), side + min(0, by)) for by in (rows, columns)]
            moved[tuple(to)] = self._seen[tuple(source)]
        self._seen = moved
