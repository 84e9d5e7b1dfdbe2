"""Obstacles in scans but not on the map, stored in map cells; they fade when no longer seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]

FARTHEST = 2.0
"""Maximum distance of stored echoes [m], since heading errors displace farther ones."""
_ERROR, _HEADING_ERROR = 0.15, 0.08
"""Pose errors [m], [rad]: echoes within these of a mapped wall may belong to that wall."""
_BEHIND = 0.2
"""Distance by which an echo must lie behind a stored obstacle to remove it [m]."""
_BINS = 360


class ObstacleLayer:
    """Cells with an obstacle, and the time each was last seen.

    Args:
        map_: Map with which echoes are compared.
        clearance: Distances to the map's own obstacles (rows, columns) [m].
        memory: Time after which an obstacle no longer seen is dropped [s].
    """

    def __init__(self, map_: OccupancyMap, clearance: NDArray[np.float32], memory: float) -> None:
        self._map, self._clearance, self._memory = map_, clearance, memory
        self._seen: dict[tuple[int, int], float] = {}

    def __len__(self) -> int:
        """Return the number of cells with an obstacle."""
        return len(self._seen)

    def points(self) -> Array:
        """Return the centres of the cells with an obstacle (n, 2) [m]."""
        cells = np.array(list(self._seen), np.intp).reshape(-1, 2)
        return self._map.cell_to_world(cells[:, 0], cells[:, 1])

    def clear(self) -> None:
        """Discard all obstacles."""
        self._seen.clear()

    def update(self, now: float, pose: Array, points: Array, close_to_walls: bool = False) -> None:
        """Process the echoes of a scan.

        Args:
            now: Steady time [s].
            pose: Pose of the robot at the scan (3,) [m, m, rad].
            points: Echoes in the robot's frame (n, 2) [m].
            close_to_walls: Whether echoes close to a mapped wall count as obstacles too.
        """
        self._fade(now, pose, points)
        distance = np.hypot(points[:, 0], points[:, 1])
        near = distance < FARTHEST
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = points[near, 0], points[near, 1]
        placed = np.column_stack((pose[0] + c * x - s * y, pose[1] + s * x + c * y))
        rows, columns = self._map.world_to_cell(placed)
        height, width = self._clearance.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns, distance = rows[inside], columns[inside], distance[near][inside]
        error = 0.0 if close_to_walls else _ERROR + _HEADING_ERROR * distance
        new = self._clearance[rows, columns] > error
        for cell in zip(rows[new].tolist(), columns[new].tolist(), strict=True):
            self._seen[cell] = now

    def _fade(self, now: float, pose: Array, points: Array) -> None:
        """Remove obstacles that are too old, or that the scan sees through."""
        if not self._seen:
            return
        self._seen = {cell: at for cell, at in self._seen.items() if now - at <= self._memory}
        kept = self.points() - pose[:2]
        away = np.hypot(kept[:, 0], kept[:, 1])
        bearing = np.arctan2(kept[:, 1], kept[:, 0]) - pose[2]
        seen_to = np.zeros(_BINS)  # nothing is known along beams without an echo
        bins = _bin(np.arctan2(points[:, 1], points[:, 0]))
        order = np.argsort(-np.hypot(points[:, 0], points[:, 1]))  # the nearest echo of a bin is written last
        seen_to[bins[order]] = np.hypot(points[order, 0], points[order, 1])
        # Neighbouring beams count as well, because heading errors displace an obstacle's edge.
        least = np.minimum(seen_to, np.minimum(np.roll(seen_to, 3), np.roll(seen_to, -3)))
        through = least[_bin(bearing)] > away + _BEHIND
        gone = [cell for cell, is_gone in zip(list(self._seen), through.tolist(), strict=True) if is_gone]
        for cell in gone:
            del self._seen[cell]


def _bin(bearing: Array) -> NDArray[np.intp]:
    return np.rint(np.mod(bearing, 2.0 * math.pi) * (_BINS / (2.0 * math.pi))).astype(np.intp) % _BINS
