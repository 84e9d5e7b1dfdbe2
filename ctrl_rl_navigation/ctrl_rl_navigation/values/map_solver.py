"""Solves the time to reach a goal on a map: speeds from the clearance, then fast marching from the goal."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.fast_marching import BORDER, Front, make_front, march, seed, widen
from ctrl_rl_navigation.values.map_value import MapValue
from ctrl_rl_navigation.values.path_corridor import distances_to_path

SLOWEST = 0.6
"""Fraction of the full speed next to an obstacle, which makes paths prefer open space slightly."""
EASE = 0.2
"""Additional clearance for full speed [m]."""
_BAND = 0.35
"""Depth of the band near obstacles that still has a time [m], because a pose with errors may lie there."""
_BURIED = 0.1
"""Depth inside obstacles that still has a time [m]."""
_BAND_SPEED = 0.1
"""Fraction of the full speed in that band, so that every path leads back to open space."""
_EXACT = 3.0
"""Width of the ring around the goal disc with exact times [cells]."""
_BESIDE = 0.1
"""Distance from a given path at which the time to cross a cell is twice that on it [m], so that robots keep to it."""
_CHUNK = 20_000
"""Number of cells between checks whether the result is still needed."""

Array = NDArray[np.float64]
Report = Callable[[float], None]


def longest_time_beside(distance: float, limits: DriveLimits) -> float:
    """Return the time to reach [s] above which a place at this distance from a goal [m] must lie behind a wall."""
    return distance / (_BAND_SPEED * limits.speed)


class CancelledError(Exception):
    """The value is no longer needed."""


class MapSolver:
    """Solves times to reach on one map for one robot.

    Attributes:
        map: Map with the obstacles.
        limits: Size and speed of the robot.
        clearance: Distances from the cells to the map's obstacles (rows, columns) [m].
    """

    def __init__(
        self,
        map_: OccupancyMap,
        limits: DriveLimits,
        slowest: float = SLOWEST,
        ease: float = EASE,
        unknown_is_free: bool = False,
    ) -> None:
        """Precompute the data shared by all goals.

        Args:
            map_: Map with the obstacles.
            limits: Size and speed of the robot.
            slowest: Fraction of the full speed next to an obstacle; 1.0 for the shortest time.
            ease: Additional clearance for full speed [m].
            unknown_is_free: Whether unknown cells and the space outside the map are drivable.
        """
        self.map, self.limits, self._slowest, self._ease = map_, limits, slowest, ease
        self.clearance = map_.clearance(unknown_is_free)

    def no_place(self, place: Array) -> str:
        """Return in words why no robot can be at a place (2,) [m]; "" if it can."""
        row, column = self.map.world_to_cell(place)
        height, width = self.clearance.shape
        if not (0 <= row < height and 0 <= column < width):
            return "off the map"
        return "" if self.clearance[row, column] > 0.0 else "where the map has an obstacle or nothing"

    def solve(
        self,
        goal: tuple[float, float],
        radius: float,
        obstacles: Array | None = None,
        report: Report | None = None,
        wanted: Callable[[], bool] | None = None,
        widest: float = 0.0,
        along: tuple[Array, float] | None = None,
    ) -> MapValue:
        """Solve the time to reach a disc.

        Args:
            goal: Centre of the disc [m].
            radius: Radius of the disc [m].
            obstacles: Positions of unmapped obstacles (n, 2) [m].
            report: Called with the completed fraction, 0 to 1.
            wanted: Returns whether the value is still needed.
            widest: Radius of the disc used if the first one has no room for the robot [m].
            along: Path to follow (n, 2) [m], and the distance from it within which the robot drives [m]; None for
                the shortest time.

        Raises:
            NavigationError: The goal is outside the map, or the disc has no room for the robot.
            CancelledError: The value is no longer needed.
        """
        begin = time.monotonic()
        clearance = self.clearance if obstacles is None else self._with_obstacles(obstacles)
        open_, slowness = clearance >= self.limits.room, self._slowness(clearance)
        if along is not None:
            beside = distances_to_path(self.map, *along)
            open_ &= np.isfinite(beside)
            slowness *= 1.0 + beside / _BESIDE
        front = make_front(np.where(open_, slowness, 0.0))
        places = self._around(goal, max(radius, widest), clearance, open_)
        if not (places[2] <= radius).any():
            radius = max(radius, widest)
        seed(front, *self._seeds(front, places, radius))
        self._run(front, int(np.count_nonzero(open_)), report, wanted)
        # First free but tight space, then obstacles, so that no time propagates through a wall from behind.
        slow = self.map.resolution / (_BAND_SPEED * self.limits.speed)
        for tight, depth in (((clearance > 0.0) & ~open_, _BAND), (clearance <= 0.0, _BURIED)):
            widen(front, np.pad(np.where(tight, slow, 0.0), BORDER).ravel())
            while march(front, _CHUNK, math.ceil(depth / self.map.resolution)):
                self._check(wanted)
        times = self._inside(front, open_.shape).astype(np.float32)
        return MapValue(times, self.map, goal, radius, time.monotonic() - begin, along is not None)

    def _slowness(self, clearance: NDArray[np.float32]) -> Array:
        """Return the time to cross each cell [s]."""
        ease = np.clip((clearance - self.limits.room) / self._ease, 0.0, 1.0)
        speed = self.limits.speed * (self._slowest + (1.0 - self._slowest) * ease)
        return np.asarray(self.map.resolution / speed, np.float64)

    def _with_obstacles(self, points: Array) -> NDArray[np.float32]:
        """Return the clearance with additional obstacles; only nearby cells change."""
        out = self.clearance.copy()
        reach = self.limits.room + self._ease
        cells = math.ceil(reach / self.map.resolution)
        height, width = out.shape
        offsets = np.arange(-cells, cells + 1)
        places = self.map.to_grid(points)
        for row, column in places[np.isfinite(places).all(axis=1)]:
            rows = offsets + round(row)
            columns = offsets + round(column)
            rows, columns = rows[(rows >= 0) & (rows < height)], columns[(columns >= 0) & (columns < width)]
            if rows.size and columns.size:
                distance = np.hypot(rows[:, None] - row, columns - column) * self.map.resolution
                part = out[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
                np.minimum(part, distance, out=part, casting="unsafe")
        return out

    def _around(
        self, goal: tuple[float, float], radius: float, clearance: NDArray[np.float32], open_: NDArray[np.bool_]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Return rows, columns and distances [m] of the cells around a goal, visible from it, with room for the robot.

        Raises:
            NavigationError: The goal is outside the map, or there is no such cell within the radius.
        """
        row, column = self.map.to_grid(goal)
        height, width = open_.shape
        if not (-0.5 <= row < height - 0.5 and -0.5 <= column < width - 0.5):
            raise NavigationError(f"the goal ({goal[0]:.2f}, {goal[1]:.2f}) lies off the map")
        reach = math.ceil(radius / self.map.resolution + _EXACT)
        rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
        rows, columns = rows + round(row), columns + round(column)
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = rows[inside], columns[inside]
        distance = np.hypot(rows - row, columns - column) * self.map.resolution
        t = np.linspace(0.0, 1.0, 4 * reach + 1)
        between_rows = np.rint(row + t * (rows[:, None] - row)).astype(int).clip(0, height - 1)
        between_columns = np.rint(column + t * (columns[:, None] - column)).astype(int).clip(0, width - 1)
        # The goal itself may be closer to a wall than the robot can get.
        seen = open_[rows, columns] & (clearance[between_rows, between_columns] > 0.0).all(axis=1)
        if not (seen & (distance <= radius)).any():
            here = float(clearance[min(max(round(row), 0), height - 1), min(max(round(column), 0), width - 1)])
            raise NavigationError(
                f"the goal ({goal[0]:.2f}, {goal[1]:.2f}) is {here:.2f} m from an obstacle or unknown space: "
                f"the robot needs {self.limits.room:.2f} m"
            )
        return rows[seen], columns[seen], distance[seen]

    def _seeds(
        self, front: Front, places: tuple[NDArray[np.intp], NDArray[np.intp], Array], radius: float
    ) -> tuple[NDArray[np.int64], Array]:
        """Return the cells in and close to the disc, and their exact times [s]."""
        rows, columns, distance = places
        near = distance <= radius + _EXACT * self.map.resolution
        cells = ((rows + BORDER) * front.stride + columns + BORDER)[near]
        seconds = np.maximum(distance[near] - radius, 0.0) / self.map.resolution * front.slowness[cells]
        return cells.astype(np.int64), seconds

    def _run(self, front: Front, total: int, report: Report | None, wanted: Callable[[], bool] | None) -> None:
        left = 1
        while left:
            left = march(front, _CHUNK, 0)
            self._check(wanted)
            if report is not None:
                report(min(1.0, float(front.counts[1]) / max(total, 1)))

    def _check(self, wanted: Callable[[], bool] | None) -> None:
        if wanted is not None and not wanted():
            raise CancelledError

    def _inside(self, front: Front, shape: tuple[int, ...]) -> Array:
        return front.times.reshape(-1, front.stride)[BORDER:-BORDER, BORDER:-BORDER].reshape(shape)
