"""The time to reach a goal pose on a map for a car, from any x, y, heading and in either gear."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import OccupancyMap

Array = NDArray[np.float64]
Times = NDArray[np.float32]

_STEP = 1.0
"""Length of an arc of a path [cells]."""
_NEAR = 2
"""Distance at which a pose without a time looks for one [cells]: errors of the pose may put the car into a margin."""
_KEPT = 0.7
"""Fraction of the margin that a path keeps, since its poses lie between those of the grid."""
_STALL = 8
"""Number of arcs of a path without a lower value after which it ends."""


@njit(inline="always")
def time_at(times: Any, gear: int, heading: float, row: float, column: float) -> float:
    """Interpolate the time [s] of a gear at a pose: heading in steps, row and column in cells; inf where there is none.

    Of the eight states around the pose, those without a time are left out.
    """
    _, headings, height, width = times.shape
    below, low, left = math.floor(heading), math.floor(row), math.floor(column)
    total = weight = 0.0
    for k in range(2):
        h = (int(below) + k) % headings
        p = heading - below if k else 1.0 - (heading - below)
        for i in range(2):
            r = int(low) + i
            if r < 0 or r >= height:
                continue
            u = row - low if i else 1.0 - (row - low)
            for j in range(2):
                c = int(left) + j
                if c < 0 or c >= width:
                    continue
                time = times[gear, h, r, c]
                if time < np.inf:
                    share = p * u * (column - left if j else 1.0 - (column - left))
                    total += share * time
                    weight += share
    return total / weight if weight > 1e-6 else np.inf


@njit(inline="always")
def _room_at(room: Any, heading: float, row: float, column: float) -> float:
    """Interpolate the room around the car at a pose: heading in steps, row and column in cells [m]; 0 off the grid."""
    headings, height, width = room.shape
    below, low, left = math.floor(heading), math.floor(row), math.floor(column)
    if not (0 <= low < height - 1 and 0 <= left < width - 1):
        return 0.0
    p, u, v, total = heading - below, row - low, column - left, 0.0
    for k in range(2):
        plane = room[(int(below) + k) % headings]
        first = (1.0 - v) * plane[low, left] + v * plane[low, left + 1]
        second = (1.0 - v) * plane[low + 1, left] + v * plane[low + 1, left + 1]
        total += (p if k else 1.0 - p) * ((1.0 - u) * first + u * second)
    return total


@cached_njit
def _values(times: Times, places: Array, out: Array) -> None:
    """Fill in the lesser time of the two gears (n,) at places (n, 3): heading in steps, row and column in cells."""
    for i in range(len(places)):
        heading, row, column = places[i]
        out[i] = min(time_at(times, 0, heading, row, column), time_at(times, 1, heading, row, column))


@cached_njit
def _descend(
    times: Times, room: Times, place: Array, radius: float, seconds: Array, change: float, least_room: float, out: Array
) -> int:
    """Fill in poses (n, 3) of the best arcs from a place (3,), in steps and cells, and return their number.

    Args:
        times: Times of the states.
        room: Room around the car in the states [m].
        place: Heading, row and column.
        radius: Radius of the tightest turn [cells].
        seconds: Duration of an arc forward and in reverse (2,) [s].
        change: Time of a change between the gears [s].
        least_room: Room that is kept, unless there is less already [m].
        out: Poses of the path.
    """
    headings = times.shape[1]
    step = 2.0 * math.pi / headings
    heading, row, column = place
    forward = time_at(times, 0, heading, row, column)
    gear = 0 if forward <= time_at(times, 1, heading, row, column) else 1
    best, stalled, count = np.inf, 0, 0
    while count < len(out):
        out[count, 0], out[count, 1], out[count, 2] = heading, row, column
        count += 1
        here = time_at(times, gear, heading, row, column)
        stalled = 0 if here < best - 1e-4 else stalled + 1
        best = min(best, here)
        if here <= 0.0 or stalled > _STALL:
            break
        enough = min(least_room, _room_at(room, heading, row, column))
        least, to_heading, to_row, to_column, to_gear = np.inf, heading, row, column, gear
        for other in range(2):
            way = _STEP if other == 0 else -_STEP
            for turn in (-1.0, 0.0, 1.0):
                half = 0.5 * turn * way / radius
                middle, chord = heading * step + half, way * (math.sin(half) / half if turn else 1.0)
                h = (heading + 2.0 * half / step) % headings
                r, c = row + chord * math.sin(middle), column + chord * math.cos(middle)
                cost = seconds[other] + time_at(times, other, h, r, c) + (change if other != gear else 0.0)
                if cost < least and _room_at(room, h, r, c) >= enough:
                    least, to_heading, to_row, to_column, to_gear = cost, h, r, c, other
        if least == np.inf:
            break
        heading, row, column, gear = to_heading, to_row, to_column, to_gear
    return count


class GridPlace(NamedTuple):
    """Where the grid of a value lies on the map: position and direction of its first cell, and its steps.

    Attributes:
        x: Position of the first cell's centre [m].
        y: Position of the first cell's centre [m].
        yaw: Direction of the rows [rad].
        cell: Length of a cell [m].
        step: Angle between headings [rad].
    """

    x: float
    y: float
    yaw: float
    cell: float
    step: float


@dataclass(frozen=True, eq=False)
class CarValue:
    """The time to reach a goal pose, usable like the suite's other value functions.

    Attributes:
        all_times: Times by gear (0 forward, 1 reverse), heading, row and column (2, H, R, C) [s]; inf where the goal is
            unreachable or the car collides.
        room: Distance from the car to the nearest obstacle by heading, row and column (H, R, C) [m], up to a limit.
        map: Map of the grid, in its resolution.
        goal: Position of the goal in the map frame (2,) [m].
        heading: Heading at the goal [rad]; None for any.
        radius: Distance from the goal at which the time may be zero [m].
        heading_tolerance: Difference from the goal's heading at which it may be [rad].
        seconds: Duration of the solve [s].
        turning_radius: Radius of the tightest turn [m].
        speeds: Forward and reverse speed [m/s].
        change: Time of a change between forward and reverse [s].
        margin: Distance that the car keeps to obstacles [m].
        complete: Whether all states that lead to the goal have a time; else those far beyond the car have none.
    """

    all_times: Times
    room: Times
    map: OccupancyMap
    goal: tuple[float, float]
    heading: float | None
    radius: float
    heading_tolerance: float
    seconds: float
    turning_radius: float
    speeds: tuple[float, float]
    change: float
    margin: float
    complete: bool = True

    state_names = ("x", "y", "theta")

    @property
    def place(self) -> GridPlace:
        """Where the grid lies on the map."""
        x, y = self.map.cell_to_world(0, 0).tolist()
        return GridPlace(x, y, self.map.origin[2], self.map.resolution, 2.0 * math.pi / self.all_times.shape[1])

    @cached_property
    def times(self) -> Times:
        """Times by position, with the best heading and gear (R, C) [s]."""
        out: Times = self.all_times.min(axis=(0, 1))
        return out

    def value(self, states: ArrayLike) -> Array:
        """Return the times from rest (...) at poses (..., 3) [m, m, rad], or with the best heading at points (..., 2).

        NaN off the map, inf where the goal is unreachable.
        """
        poses = np.asarray(states, np.float64)
        grid = self.map.to_grid(poses[..., :2]).reshape(-1, 2)
        height, width = self.map.cells.shape
        finite = np.isfinite(poses).all(axis=-1).reshape(-1)
        inside = finite & (grid > -0.5).all(axis=1) & (grid < (height - 0.5, width - 0.5)).all(axis=1)
        out = np.full(len(grid), np.nan)
        if poses.shape[-1] == 2:
            out[inside] = self.times[tuple(np.rint(grid[inside]).astype(int).T)]
        else:
            found = np.empty(int(inside.sum()))
            _values(self.all_times, self._places(poses.reshape(-1, 3)[inside]), found)
            out[inside] = found
        return out.reshape(poses.shape[:-1])

    def time_near(self, pose: Array) -> float:
        """Return the time from rest at a pose (3,) [s], or from a pose a cell and a step away if it has none there."""
        time = float(self.value(pose))
        if math.isfinite(time):
            return time
        heading, row, column = np.rint(self._places(pose.reshape(1, 3))[0]).astype(int).tolist()
        _, headings, height, width = self.all_times.shape
        rows = slice(max(row - _NEAR, 0), max(min(row + _NEAR + 1, height), 0))
        columns = slice(max(column - _NEAR, 0), max(min(column + _NEAR + 1, width), 0))
        around = np.arange(heading - 1, heading + 2) % headings
        return float(np.min(self.all_times[:, around, rows, columns], initial=math.inf))

    def value_and_gradient(self, states: ArrayLike) -> tuple[Array, Array]:
        """Return times (...) [s] and gradients (..., 3) [s/m, s/m, s/rad] at poses (..., 3) [m, m, rad].

        Gradients are differences over a cell and over a step of the heading; NaN where a side has no time.
        """
        poses = np.asarray(states, np.float64)
        steps = np.diag((0.5 * self.map.resolution, 0.5 * self.map.resolution, 0.5 * self.place.step))
        sides = [(self.value(poses + step), self.value(poses - step)) for step in steps]
        with np.errstate(invalid="ignore"):
            slopes = [(up - down) / (2.0 * step.max()) for (up, down), step in zip(sides, steps, strict=True)]
        gradient = np.stack(slopes, axis=-1)
        return self.value(poses), np.where(np.isfinite(gradient), gradient, np.nan)

    def path(self, start: ArrayLike, longest: int = 20_000) -> Array:
        """Return the positions (n, 2) of the best arcs from a pose (3,) [m, m, rad].

        Args:
            start: First pose of the path.
            longest: Maximum number of positions.
        """
        return self.poses(start, longest)[:, :2]

    def poses(self, start: ArrayLike, longest: int = 20_000) -> Array:
        """Return the poses (n, 3) [m, m, rad] of the best arcs from a pose (3,)."""
        place = self._places(np.asarray(start, np.float64).reshape(1, 3))[0]
        cell = self.map.resolution
        seconds = np.array([_STEP * cell / speed for speed in self.speeds])
        out = np.empty((longest, 3))
        radius, room = self.turning_radius / cell, _KEPT * self.margin
        count = _descend(self.all_times, self.room, place, radius, seconds, self.change, room, out)
        positions = self.map.cell_to_world(out[:count, 1], out[:count, 2])
        return np.column_stack((positions, out[:count, 0] * self.place.step + self.map.origin[2]))

    def _places(self, poses: Array) -> Array:
        """Return headings in steps, and rows and columns in cells (n, 3), of poses (n, 3)."""
        headings = np.mod(poses[:, 2] - self.map.origin[2], 2.0 * math.pi) / self.place.step
        return np.column_stack((headings, self.map.to_grid(poses[:, :2])))
