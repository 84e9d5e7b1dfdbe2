"""Solves the time to reach a goal pose on a map for a car."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.cars.arcs import allow_arcs, longest_of, make_arcs
from ctrl_rl_navigation.cars.car_limits import CarLimits
from ctrl_rl_navigation.cars.car_value import CarValue
from ctrl_rl_navigation.cars.footprint import distances, fit_all, footprint_of
from ctrl_rl_navigation.cars.room import fill_room
from ctrl_rl_navigation.cars.sweeps import FAR, Spread
from ctrl_rl_navigation.cars.tiles import sharing, tiling_of
from ctrl_rl_navigation.errors import NavigationError
from ctrl_rl_navigation.values.map_solver import CancelledError, Report

Array = NDArray[np.float64]

HEADINGS = 72
CELL = 0.05
"""Minimum length of the solver's cells [m]; those of a finer map are joined."""
_LARGEST_CELL = 0.1
"""Length of a cell up to which a map's cells are joined for a large car [m]."""
_CELLS_PER_RADIUS = 12.0
"""Minimum turning radius [cells]; finer cells hardly change the times."""
_WINDOW = 8.0
"""Way of the car within which tiles are swept together [cells]."""
_BEYOND, _SHARE_BEYOND = 5.0, 0.1
"""Time that is solved beyond that of the car's own pose [s], and as a share of that: the car may stray from its way."""
_SEED_CELLS = 0.75
"""Radius of the smallest goal disc [cells]: less may lie between the cells."""


class FreeSpace(NamedTuple):
    """Where a car touches nothing, by state.

    Attributes:
        room: Distance from its rectangle to the nearest obstacle, up to what matters (headings, rows, columns) [m].
        allowed: Bits of the arcs that are free, and of those that are easy (2, headings, rows, columns).
    """

    room: NDArray[np.float32]
    allowed: NDArray[np.uint32]


class CarSolver:
    """Solves times to reach on one map for one car.

    Attributes:
        map: Map with the obstacles.
        limits: Size and limits of the car.
        clearance: Distances from the map's cells to its obstacles (rows, columns) [m].
        grid: Map of the solver's cells, in its resolution.
    """

    def __init__(
        self, map_: OccupancyMap, limits: CarLimits, headings: int = HEADINGS, cell: float | None = None
    ) -> None:
        """Precompute what all goals share: the arcs, and which of them collide.

        Args:
            map_: Map with the obstacles; unknown cells are no place to drive.
            limits: Size and limits of the car.
            headings: Number of headings.
            cell: Length of a cell that the solver's should not exceed [m]; by default that of `cell_for`.
        """
        self.map, self.limits, self._headings = map_, limits, headings
        self.clearance = map_.clearance()
        wanted = cell_for(limits) if cell is None else cell
        self._joined = max(1, int(wanted / map_.resolution + 1e-6))
        self.grid = joined(map_, self._joined)
        radius = limits.turning_radius / self.grid.resolution
        longest = longest_of(radius, headings)
        self._tiling = tiling_of(self.grid.cells.shape, math.ceil(longest) + 2)
        self._speeds = (limits.speed, limits.reverse_speed)
        self._arcs = make_arcs(radius, headings, self._speeds, self.grid.resolution)
        shift = 4.0 * math.sqrt(self.grid.resolution * limits.turning_radius)
        self._aside = shift / min(self._speeds) + 2.0 * limits.change_time
        # On an arc each point of the car moves at most this far.
        self._reach = longest * self.grid.resolution * (1.0 + limits.radius / limits.turning_radius)
        size = (headings, *self._tiling.shape)
        self._space = FreeSpace(np.zeros(size, np.float32), np.zeros((2, *size), np.uint32))
        self._fill(self._space, self.clearance, np.ones((self._tiling.rows, self._tiling.columns), np.bool_))

    def _fill(self, space: FreeSpace, clearance: NDArray[np.float32], tiles: NDArray[np.bool_]) -> None:
        """Fill in the free space of marked tiles, by the clearance of the map's cells (rows, columns) [m]."""
        limits, resolution = self.limits, self.map.resolution
        rectangle = footprint_of(limits.length, limits.width, limits.centre, 0.0, resolution)
        field, most = (
            distances(clearance, resolution),
            (limits.margin + 0.5 * self.grid.resolution + self._reach) / resolution,
        )
        place = float(self._joined), 0.5 * (self._joined - 1), self._tiling.border
        easy = limits.margin + 0.5 * self.grid.resolution
        rooms = np.float32(limits.margin), np.float32(easy), np.float32(self._reach)
        corners = self._tiling.corners(tiles)
        with sharing() as share:
            share(lambda part: fill_room(field, rectangle, *place, most, resolution, part, space.room), corners)
            share(lambda part: allow_arcs(space.room, self._arcs, *rooms, part, space.allowed), corners)

    def fits(self, poses: ArrayLike, margin: float | None = None) -> NDArray[np.bool_]:
        """Return whether the car stands free of obstacles at poses (..., 3) [m, m, rad].

        Args:
            poses: Poses of the rear axle's middle in the map frame.
            margin: Distance to obstacles [m]; by default that of the limits.
        """
        limits, resolution = self.limits, self.map.resolution
        margin = limits.margin if margin is None else margin
        rectangle = footprint_of(limits.length, limits.width, limits.centre, margin, resolution)
        states = np.asarray(poses, np.float64)
        places = np.column_stack((self.map.to_grid(states[..., :2]).reshape(-1, 2), states[..., 2].reshape(-1)))
        places[:, 2] -= self.map.origin[2]
        return fit_all(distances(self.clearance, resolution), places, rectangle).reshape(states.shape[:-1])

    def solve(
        self,
        goal: tuple[float, float],
        heading: float | None,
        radius: float,
        heading_tolerance: float,
        obstacles: Array | None = None,
        report: Report | None = None,
        wanted: Callable[[], bool] | None = None,
        start: Array | None = None,
    ) -> CarValue:
        """Solve the time to reach a pose.

        Args:
            goal: Position of the goal [m].
            heading: Heading at the goal [rad]; None for any.
            radius: Distance from the position at which the time is zero [m].
            heading_tolerance: Difference from the heading at which it is zero [rad].
            obstacles: Positions of unmapped obstacles (n, 2) [m].
            report: Called with the completed fraction, 0 to 1.
            wanted: Returns whether the value is still needed.
            start: Pose of the car (3,) [m, m, rad]: the solve ends a while after its time is known, and farther states
                have none. By default all of the map is solved.

        Raises:
            NavigationError: The goal is off the map, or the car does not fit there.
            CancelledError: The value is no longer needed.
        """
        begin = time.monotonic()
        space = self._space
        if obstacles is not None and len(obstacles):
            space = self._with_obstacles(obstacles)
        free = space.room >= np.float32(self.limits.margin)
        change, grid = self.limits.change_time, self.grid
        window = _WINDOW * grid.resolution / max(self._speeds)
        spread = Spread(free, space.allowed, self._arcs, self._tiling, change, self._aside, window)
        spread.seed(self._goal_states(goal, heading, radius, heading_tolerance, free))
        known = (lambda: math.inf) if start is None else partial(self._time_at, spread, np.asarray(start, np.float64))
        complete = self._run(spread, report, wanted, known)
        inner = tuple(slice(self._tiling.border, self._tiling.border + size) for size in grid.cells.shape)
        times = spread.values[:, :, *inner]
        times[times > min(spread.final, 0.5 * float(FAR))] = np.inf
        seconds = time.monotonic() - begin
        return CarValue(
            times,
            space.room[:, *inner],
            grid,
            goal,
            heading,
            radius,
            heading_tolerance,
            seconds,
            self.limits.turning_radius,
            self._speeds,
            change,
            self.limits.margin,
            complete,
        )

    def _time_at(self, spread: Spread, pose: Array) -> float:
        """Return the time of the state nearest to a pose (3,) in a solve [s]; inf as long as it is not final."""
        row, column = np.rint(self.grid.to_grid(pose[:2])).astype(int)
        heading = round((float(pose[2]) - self.grid.origin[2]) / (2.0 * math.pi) * self._headings) % self._headings
        height, width = self.grid.cells.shape
        if not (0 <= row < height and 0 <= column < width):
            return math.inf
        border = self._tiling.border
        time = float(spread.values[:, heading, row + border, column + border].min())
        return time if time <= spread.final else math.inf

    def _run(
        self, spread: Spread, report: Report | None, wanted: Callable[[], bool] | None, known: Callable[[], float]
    ) -> bool:
        """Spread the values; return whether all states have theirs, or False if the known time was enough."""
        with sharing() as share:
            while spread.advance(share):
                if wanted is not None and not wanted():
                    raise CancelledError
                if report is not None:
                    report(spread.reached)
                if spread.final > (1.0 + _SHARE_BEYOND) * known() + _BEYOND:
                    return False
        return True

    def _with_obstacles(self, points: Array) -> FreeSpace:
        """Return the free space with additional obstacles (n, 2) [m]."""
        rows, columns = self.map.world_to_cell(points)
        height, width = self.map.cells.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = rows[inside], columns[inside]
        cells = self.map.cells.copy()
        cells[rows, columns] = 100
        clearance = OccupancyMap(cells, self.map.resolution, self.map.origin).clearance()
        away = self.limits.radius + self.limits.margin + 2.0 * self._reach
        touched = self._tiling.around(rows // self._joined, columns // self._joined, away / self.grid.resolution)
        space = FreeSpace(self._space.room.copy(), self._space.allowed.copy())
        self._fill(space, clearance, touched)
        return space

    def _goal_states(
        self, goal: tuple[float, float], heading: float | None, radius: float, tolerance: float, free: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Return heading, row and column of the states at the goal (n, 3).

        Raises:
            NavigationError: The goal is off the map, or the car does not fit there.
        """
        row, column = self.grid.to_grid(goal)
        height, width = self.grid.cells.shape
        where = f"({goal[0]:.2f}, {goal[1]:.2f})"
        if not (-0.5 <= row < height - 0.5 and -0.5 <= column < width - 0.5):
            raise NavigationError(f"the goal {where} lies off the map")
        reach = max(radius / self.grid.resolution, _SEED_CELLS)
        border = self._tiling.border
        places = np.argwhere(np.hypot(*np.ogrid[-row : height - row, -column : width - column]) <= reach) + border
        step = 2.0 * math.pi / self._headings
        angles = np.arange(self._headings) * step + self.grid.origin[2] - (heading or 0.0)
        away = np.abs(np.remainder(angles + math.pi, 2.0 * math.pi) - math.pi)
        facing = np.full(self._headings, True) if heading is None else away <= max(tolerance, 0.5 * step)
        headings = np.flatnonzero(facing)
        states = np.column_stack((np.repeat(headings, len(places)), np.tile(places, (len(headings), 1))))
        states = states[free[tuple(states.T)]]
        if not len(states):
            turned = "" if heading is None else f" at {math.degrees(heading):.0f} degrees"
            raise NavigationError(f"the car does not fit at the goal {where}{turned}: it is too near to an obstacle")
        return states


def cell_for(limits: CarLimits) -> float:
    """Return the length of a cell that is fine enough for a car [m]."""
    return min(max(CELL, limits.turning_radius / _CELLS_PER_RADIUS), _LARGEST_CELL)


def joined(map_: OccupancyMap, count: int) -> OccupancyMap:
    """Return a map with cells that join count x count ones; one is occupied or unknown if any of its parts is."""
    if count == 1:
        return map_
    rows, columns = (math.ceil(size / count) for size in map_.cells.shape)
    cells = np.full((rows * count, columns * count), -1, np.int8)
    cells[: map_.cells.shape[0], : map_.cells.shape[1]] = map_.cells
    parts = cells.reshape(rows, count, columns, count)
    worst = np.where((parts == 100).any(axis=(1, 3)), 100, np.where((parts == -1).any(axis=(1, 3)), -1, 0))
    return OccupancyMap(worst.astype(np.int8), map_.resolution * count, map_.origin)
