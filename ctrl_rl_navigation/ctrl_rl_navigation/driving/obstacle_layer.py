"""Obstacles in scans but not on the map, stored in map cells until beams pass through them.

Time alone proves nothing: a closed door must still be known after the way round it. Only what a scan showed briefly,
as it shows the place of somebody who walks by, is dropped after some time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.driving.scan_alignment import align

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FARTHEST = 3.5
"""Maximum distance of stored echoes [m], since heading errors displace farther ones."""
_ERROR, _HEADING_ERROR = 0.15, 0.08
"""Pose errors [m], [rad]: echoes within these of a mapped wall may belong to that wall."""
_ALIGNED, _HEADING_ALIGNED = 0.1, 0.03
"""The same for a scan that fits the map's walls."""
_BEHIND = 0.2
"""Distance by which a beam must reach beyond a stored obstacle to speak against it [m]."""
_BRIEF = 1.0
"""Time for which scans must show an obstacle for it to stay while nobody looks [s]; a walker leaves a cell sooner."""
_PASSES = 5
"""Scans without an echo from an obstacle or from behind it after which it is gone. Half a second to a second; a lidar
that misses 30 % is wrong about one obstacle in 400."""
_BINS, _BESIDE = 360, 3
"""Directions around the robot, and neighbours that count as well because heading errors displace an obstacle's edge."""
_NONE: Array = np.empty((0, 2))
_NEVER = -1e9
"""Time at which scans last showed an obstacle that they do not show any more [s]: long ago."""
_CELL = np.dtype([("cell", np.int64), ("first", float), ("last", float), ("passes", np.int64), ("held", float)])


class ObstacleLayer:
    """Cells with an obstacle.

    Each has the times at which scans first and last showed it, the number of scans that passed through it since, and
    the time until which it is held whatever they show.

    Args:
        map_: Map with which echoes are compared.
        clearance: Distances to the map's own obstacles (rows, columns) [m].
        memory: Time after which an obstacle that was seen only briefly is dropped [s].
    """

    def __init__(self, map_: OccupancyMap, clearance: NDArray[np.float32], memory: float) -> None:
        self._map, self._clearance, self._memory = map_, clearance, memory
        self._stored = np.zeros(0, _CELL)  # ascending cells

    def __len__(self) -> int:
        """Return the number of cells with an obstacle."""
        return len(self._stored)

    def points(self) -> Array:
        """Return the centres of the cells with an obstacle (n, 2) [m]."""
        rows, columns = np.divmod(self._stored["cell"], self._clearance.shape[1])
        return self._map.cell_to_world(rows, columns)

    def clear(self) -> None:
        """Discard all obstacles."""
        self._stored = self._stored[:0]

    def forget(self, now: float, age: float) -> bool:
        """Drop obstacles that no scan has shown for some time [s], held ones too, and return whether there were any."""
        self._stored["held"] = 0.0
        recent = now - self._stored["last"] <= age
        self._stored = self._stored[recent]
        return not bool(recent.all())

    def hold(self, points: Array) -> None:
        """Keep obstacles (n, 2) [m] until they are forgotten, whatever scans show; those that are gone come back."""
        cells = np.unique(self._cells(points)[0])
        self._insert(np.setdiff1d(cells, self._stored["cell"], assume_unique=True), _NEVER)
        self._stored["held"][np.isin(self._stored["cell"], cells)] = math.inf

    def update(
        self, now: float, pose: Array, points: Array, empty: Array = _NONE, close_to_walls: bool = False
    ) -> None:
        """Process a scan.

        Args:
            now: Steady time [s].
            pose: Pose of the robot at the scan (3,) [m, m, rad].
            points: Echoes in the robot's frame (n, 2) [m].
            empty: Ends of the beams without an echo in the robot's frame (m, 2) [m].
            close_to_walls: Whether echoes close to a mapped wall count as obstacles too, where the given pose has them:
                that is where they stop a robot with this pose.
        """
        aligned, fits = align(self._map, self._clearance, pose, points)
        self._fade(now, aligned, points, empty)
        cells, distance = self._echoes(pose if close_to_walls else aligned, points)
        fixed, turned = (_ALIGNED, _HEADING_ALIGNED) if fits else (_ERROR, _HEADING_ERROR)
        error = 0.0 if close_to_walls else fixed + turned * distance
        self._store(now, cells[self._clearance.ravel()[cells] > error])
        if close_to_walls:
            self._stored["held"][self._stored["last"] == now] = now + self._memory

    def _echoes(self, pose: Array, points: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the cells of near echoes (n, 2) [m] on the map, and their distances [m]."""
        distance = np.hypot(points[:, 0], points[:, 1])
        near = distance < FARTHEST
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = points[near, 0], points[near, 1]
        cells, inside = self._cells(np.column_stack((pose[0] + c * x - s * y, pose[1] + s * x + c * y)))
        return cells, distance[near][inside]

    def _cells(self, points: Array) -> tuple[NDArray[np.int64], Flags]:
        """Return the cells of the points (n, 2) [m] that lie on the map, and which do (n,)."""
        rows, columns = self._map.world_to_cell(points)
        height, width = self._clearance.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return (rows[inside] * width + columns[inside]).astype(np.int64), inside

    def _store(self, now: float, cells: NDArray[np.int64]) -> None:
        """Note that a scan shows cells (n,)."""
        cells = np.unique(cells)
        seen = np.isin(self._stored["cell"], cells)
        self._stored["last"][seen] = now
        self._stored["passes"][seen] = 0
        self._insert(np.setdiff1d(cells, self._stored["cell"][seen], assume_unique=True), now)

    def _insert(self, cells: NDArray[np.int64], seen_at: float) -> None:
        new = np.zeros(len(cells), _CELL)
        new["cell"], new["first"], new["last"] = cells, seen_at, seen_at
        both = np.concatenate((self._stored, new))
        self._stored = both[np.argsort(both["cell"])]

    def _fade(self, now: float, pose: Array, points: Array, empty: Array) -> None:
        """Remove obstacles that were seen briefly and long ago, or that scans see through."""
        stored = self._stored
        if not len(stored):
            return
        beyond, passed = self._seen_through(pose, points, empty)
        stored["passes"][passed] += 1
        brief = stored["last"] - stored["first"] < _BRIEF
        gone = beyond | (stored["passes"] >= _PASSES) | (brief & (now - stored["last"] > self._memory))
        self._stored = stored[(stored["held"] > now) | ~gone]

    def _seen_through(self, pose: Array, points: Array, empty: Array) -> tuple[Flags, Flags]:
        """Return behind which obstacles all beams have echoes (n,), and through which all pass, some without one (n,).

        An echo from behind is proof. A beam without an echo may have missed the obstacle itself.
        """
        place = self.points() - pose[:2]
        away = np.hypot(place[:, 0], place[:, 1])
        echo, miss = _nearest(points), _nearest(empty)
        bins = _bin(np.arctan2(place[:, 1], place[:, 0]) - pose[2])
        through = (np.minimum(echo, miss)[bins] > away + _BEHIND) & (away < FARTHEST)
        known = np.isfinite(echo)[bins]
        silent = np.isfinite(miss)[bins]
        return through & known & ~silent, through & silent


def _nearest(ends: Array) -> Array:
    """Return the distance of the nearest end of a beam (n, 2) [m] in and beside each direction; inf without one."""
    out = np.full(_BINS, np.inf)
    np.minimum.at(out, _bin(np.arctan2(ends[:, 1], ends[:, 0])), np.hypot(ends[:, 0], ends[:, 1]))
    around = np.arange(_BINS)[:, None] + np.arange(-_BESIDE, _BESIDE + 1)
    return np.asarray(out[around % _BINS].min(axis=1))


def _bin(bearing: Array) -> NDArray[np.intp]:
    return np.rint(np.mod(bearing, 2.0 * math.pi) * (_BINS / (2.0 * math.pi))).astype(np.intp) % _BINS
