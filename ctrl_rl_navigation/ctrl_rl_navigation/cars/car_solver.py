"""Solves the time to reach a goal pose on a map for a car."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.cars.arcs import border_of, make_arcs
from ctrl_rl_navigation.cars.car_limits import CarLimits
from ctrl_rl_navigation.cars.car_value import CarValue
from ctrl_rl_navigation.cars.footprint import distances, fit_all, footprint_of, mark_blocked
from ctrl_rl_navigation.cars.wavefront import FINAL, HEAD, Queue, grown, make_queue, seed, spread
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
_CHUNK = 200_000
"""Number of states between checks whether the result is still needed."""
_BEYOND, _SHARE_BEYOND = 5.0, 0.1
"""Time that is solved beyond that of the car's own pose [s], and as a share of that: the car may stray from its way."""
_SEED_CELLS = 0.75
"""Radius of the smallest goal disc [cells]: less may lie between the cells."""


class CarSolver:
    """Solves times to reach on one map for one car.

    Attributes:
        map: Map with the obstacles.
        limits: Size and limits of the car.
        clearance: Distances from the map's cells to its obstacles (rows, columns) [m].
        grid: Map of the solver's cells, in its resolution.
        free: Number of free states, of one gear.
    """

    def __init__(
        self, map_: OccupancyMap, limits: CarLimits, headings: int = HEADINGS, cell: float | None = None
    ) -> None:
        """Precompute what all goals share: in which poses the car collides, and its arcs.

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
        self._border = border_of(radius, headings)
        height, width = self.grid.cells.shape
        self._shape = (headings, height + 2 * self._border, width + 2 * self._border)
        self._speeds = (limits.speed, limits.reverse_speed)
        self._arcs = make_arcs(radius, headings, self._speeds, self.grid.resolution, self._shape[1:])
        shift = 4.0 * math.sqrt(self.grid.resolution * limits.turning_radius)
        self._aside = shift / min(self._speeds) + 2.0 * limits.change_time
        self._blocked, self.free = self._collisions(self.clearance)

    def _collisions(self, clearance: NDArray[np.float32]) -> tuple[NDArray[np.bool_], int]:
        """Return in which poses the car collides (headings, rows, columns), and the number of the others."""
        limits, resolution = self.limits, self.map.resolution
        rectangle = footprint_of(limits.length, limits.width, limits.centre, limits.margin, resolution)
        behind = 0.5 * limits.length - limits.centre
        near = (min(0.5 * limits.width, behind) + limits.margin) / resolution
        far = (limits.radius + math.sqrt(2.0) * limits.margin) / resolution
        out = np.empty((self._headings, *self.grid.cells.shape), np.bool_)
        field = distances(clearance, resolution)
        return out, mark_blocked(field, rectangle, float(self._joined), 0.5 * (self._joined - 1), far, near, out)

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
        blocked, free = self._blocked, self.free
        if obstacles is not None and len(obstacles):
            blocked, free = self._with_obstacles(obstacles)
        values = np.full((2, *self._shape), np.inf, np.float32)
        border = self._border
        values[:, :, border:-border, border:-border] = np.where(blocked, np.float32(np.inf), np.float32(-np.inf))
        flat, queue = values.reshape(-1), self._queue()
        seed(flat, queue, self._goal_states(goal, heading, radius, heading_tolerance, blocked))
        inner = values[:, :, border:-border, border:-border]
        known = (lambda: math.inf) if start is None else partial(self._time_at, inner, np.asarray(start, np.float64))
        complete = self._run(flat, queue, 2 * free, report, wanted, known)
        inner[inner < 0.0] = np.inf
        seconds = time.monotonic() - begin
        change = self.limits.change_time
        radius_of_turns = self.limits.turning_radius
        return CarValue(
            inner, self.grid, goal, heading, radius, seconds, radius_of_turns, self._speeds, change, complete
        )

    def _time_at(self, values: NDArray[np.float32], pose: Array) -> float:
        """Return the time of the state nearest to a pose (3,) in a solve [s]; inf as long as it is not final."""
        row, column = np.rint(self.grid.to_grid(pose[:2])).astype(int)
        heading = round((float(pose[2]) - self.grid.origin[2]) / (2.0 * math.pi) * self._headings) % self._headings
        _, _, height, width = values.shape
        if not (0 <= row < height and 0 <= column < width):
            return math.inf
        times = values[:, heading, row, column]
        return float(times[times >= 0.0].min(initial=math.inf))

    def _queue(self) -> Queue:
        times = self._arcs.times
        return make_queue(0.5 * float(times.min()), float(times.max()) + self._aside + self.limits.change_time)

    def _run(
        self,
        values: NDArray[np.float32],
        queue: Queue,
        total: int,
        report: Report | None,
        wanted: Callable[[], bool] | None,
        known: Callable[[], float],
    ) -> bool:
        """Spread the values; return whether all states have theirs, or False if the known time was enough."""
        left, change, waiting = 1, self.limits.change_time, np.zeros(len(values), np.uint8)
        aside = self._aside
        while left:
            left = spread(values, waiting, queue, self._arcs, self._shape, change, aside, _CHUNK)
            if left < 0:
                queue = grown(queue)
            if wanted is not None and not wanted():
                raise CancelledError
            if report is not None:
                report(min(1.0, float(queue.counts[FINAL]) / max(total, 1)))
            if queue.counts[HEAD] * queue.width > (1.0 + _SHARE_BEYOND) * known() + _BEYOND:
                return False
        return True

    def _with_obstacles(self, points: Array) -> tuple[NDArray[np.bool_], int]:
        """Return collisions with additional obstacles (n, 2) [m], and the number of free states."""
        rows, columns = self.map.world_to_cell(points)
        height, width = self.map.cells.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        cells = self.map.cells.copy()
        cells[rows[inside], columns[inside]] = 100
        return self._collisions(OccupancyMap(cells, self.map.resolution, self.map.origin).clearance())

    def _goal_states(
        self,
        goal: tuple[float, float],
        heading: float | None,
        radius: float,
        heading_tolerance: float,
        blocked: NDArray[np.bool_],
    ) -> NDArray[np.int64]:
        """Return the flat indices of the states at the goal, of both gears.

        Raises:
            NavigationError: The goal is off the map, or the car does not fit there.
        """
        row, column = self.grid.to_grid(goal)
        height, width = self.grid.cells.shape
        where = f"({goal[0]:.2f}, {goal[1]:.2f})"
        if not (-0.5 <= row < height - 0.5 and -0.5 <= column < width - 0.5):
            raise NavigationError(f"the goal {where} lies off the map")
        reach = max(radius / self.grid.resolution, _SEED_CELLS)
        rows, columns = np.mgrid[0:height, 0:width]
        near = np.hypot(rows - row, columns - column) <= reach
        step = 2.0 * math.pi / self._headings
        angles = np.arange(self._headings) * step + self.grid.origin[2] - (heading or 0.0)
        away = np.abs(np.remainder(angles + math.pi, 2.0 * math.pi) - math.pi)
        facing = np.full(self._headings, True) if heading is None else away <= max(heading_tolerance, 0.5 * step)
        free = ~blocked & facing[:, None, None] & near
        if not free.any():
            turned = "" if heading is None else f" at {math.degrees(heading):.0f} degrees"
            raise NavigationError(f"the car does not fit at the goal {where}{turned}: it is too near to an obstacle")
        places = np.argwhere(free)
        _, rows_there, columns_there = self._shape
        first = (places[:, 0] * rows_there + places[:, 1] + self._border) * columns_there + places[:, 2] + self._border
        return np.concatenate((first, first + math.prod(self._shape))).astype(np.int64)


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
