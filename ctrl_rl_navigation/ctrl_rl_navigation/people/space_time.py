"""The delay that people cause around the robot, solved backwards over time, x and y.

The time to reach the goal past people is that of the map plus this delay. Without people the delay is zero, as it is at
the end of the horizon. In each step the robot stands or drives on in any direction; both cost time and the risk of a
contact. So waiting, passing behind, making room, and leaving a place to which somebody comes have one cost.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.people.movers import STANDING, holds, placed, risk, spread
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_value import MapValue, value_and_slopes

Array = NDArray[np.float64]
Grid = NDArray[np.float32]

_HALF = 24
"""Number of cells from the window's middle to its edge."""
_STEPS = 20
"""Number of time steps."""
_DIRECTIONS = 16
_HORIZON = 5.0
"""Time over which movers are predicted [s]."""
_PAD = 2
"""Cells around the window that one step may reach."""
_BARRED = 1e3
"""Cost of driving into an obstacle [s]."""
_STEEP = 3.0
"""Slowness relative to that of the open above which the value knows of an obstacle."""
_ROUGH = 0.05
"""Share of a step that the best of few directions may lose against the descent."""


class Window(NamedTuple):
    """Delays around the robot at one time.

    Attributes:
        delays: Delays (n, n) [s], in rows and columns along those of the map; (0, 0) for none.
        row: Row of the first cell's centre on the map.
        column: Column of the first cell's centre on the map.
        cells: Cells of the map for each cell of the window.
    """

    delays: Grid
    row: float
    column: float
    cells: float


NO_WINDOW = Window(np.empty((0, 0), np.float32), 0.0, 0.0, 1.0)


@njit(inline="always")
def _bar(barred: Any, points: Any, times: Any, window: Any, reach: float, slow: float) -> None:
    """Bar the cells beside obstacles (2, n), in cells of the map, that the value does not know of."""
    for k in range(points.shape[1]):
        value, by_row, by_column = value_and_slopes(times, points[0, k], points[1, k])
        if value == np.inf or math.hypot(by_row, by_column) > slow:
            continue
        row, column = (points[0, k] - window.row) / window.cells, (points[1, k] - window.column) / window.cells
        for i in range(max(math.ceil(row - reach), 0), min(math.floor(row + reach) + 1, len(barred))):
            for j in range(max(math.ceil(column - reach), 0), min(math.floor(column + reach) + 1, len(barred))):
                if math.hypot(i - row, j - column) < reach:
                    barred[i, j] = True


@njit(inline="always")
def _time_at(times: Any, barred: Any, window: Any, i: float, j: float) -> float:
    """Return the time to reach at a place in cells of the window; infinite where the robot cannot be."""
    r, c = round(i), round(j)
    if 0 <= r < len(barred) and 0 <= c < len(barred) and barred[r, c]:
        return np.inf
    value, _, _ = value_and_slopes(times, window.row + i * window.cells, window.column + j * window.cells)
    return value


@cached_njit
def excesses(times: Any, window: Any, points: Any, reach: float, step: float, stride: float, out: Any) -> None:
    """Fill in the time that a step in each direction loses against the best one (directions, n, n) [s].

    Args:
        times: Times to reach on the map [s].
        window: Geometry of the window.
        points: Obstacles that the map may lack (2, n), in cells of the map.
        reach: Distance to obstacles, in cells of the window.
        step: Duration of a step [s].
        stride: Length of a step at full speed, in cells of the window.
        out: Result.
    """
    directions, n = out.shape[0], out.shape[1]
    barred = np.zeros((n, n), np.bool_)
    fastest = step / (stride * window.cells)  # time for one cell of the map in the open
    _bar(barred, points, times, window, reach, _STEEP * fastest)
    for i in range(n):
        for j in range(n):
            value, by_row, by_column = value_and_slopes(
                times, window.row + i * window.cells, window.column + j * window.cells
            )
            slope = math.hypot(by_row, by_column)
            gain = (1.0 - _ROUGH) * step * max(slope / fastest, 1.0)
            for k in range(directions):
                angle = 2.0 * math.pi * k / directions
                next_i, next_j = i + stride * math.sin(angle), j + stride * math.cos(angle)
                after = _time_at(times, barred, window, next_i, next_j)
                if after == np.inf:
                    out[k, i, j] = _BARRED
                elif value == np.inf:
                    out[k, i, j] = 0.0  # any way out of an obstacle is good
                else:
                    out[k, i, j] = max(min(gain, value) + after - value, 0.0)  # at the goal no time is lost


@njit(inline="always")
def _risks(movers: Any, time: float, cell: float, room: float, out: Any) -> None:
    """Fill in the cost of a second at each cell for a robot that drives (n, n) [s/s]."""
    n = len(out)
    low = -0.5 * (n - 1) * cell
    out[:] = 0.0
    for m in range(len(movers)):
        if not holds(movers, m, time):
            continue
        x, y = movers[m, 0] + time * movers[m, 2], movers[m, 1] + time * movers[m, 3]
        variance, radius = spread(movers, m, time), movers[m, 4] + room
        for i in range(n):
            dy = low + i * cell - y
            for j in range(n):
                out[i, j] += movers[m, 8] * risk(math.hypot(low + j * cell - x, dy), radius, variance)


@njit(fastmath=True)
def _step_back(later: Any, best: Any, excess: Any, stride: float) -> None:
    """Lower `best` to the delays after a step in the cheapest direction; `later` is padded."""
    n = len(best)
    for k in range(len(excess)):
        angle = 2.0 * math.pi * k / len(excess)
        rise, run = stride * math.sin(angle), stride * math.cos(angle)
        up, right = math.floor(rise), math.floor(run)
        u, v = np.float32(rise - up), np.float32(run - right)
        one = np.float32(1.0)
        a, b, c, d = (one - u) * (one - v), (one - u) * v, u * (one - v), u * v
        for i in range(n):
            near, far = later[i + up + _PAD], later[i + up + 1 + _PAD]
            left = right + _PAD
            for j in range(n):
                after = a * near[j + left] + b * near[j + left + 1] + c * far[j + left] + d * far[j + left + 1]
                best[i, j] = min(best[i, j], after + excess[k, i, j])


@cached_njit
def solve_delays(excess: Any, movers: Any, cell: float, room: float, begin: float, step: float, stride: float) -> Grid:
    """Return the delays (n, n) [s] that movers cause from a time on.

    Args:
        excess: Time that a step in each direction loses against the best one (directions, n, n) [s].
        movers: Predicted movers (m, 12) in the window's frame, in whose middle the robot is now.
        cell: Side length of a cell [m].
        room: Distance from the robot's centre to a mover's surface below which they touch [m].
        begin: That time, from now on [s].
        step: Duration of a step [s].
        stride: Length of a step [cells].
    """
    n = excess.shape[1]
    later = np.zeros((n + 2 * _PAD, n + 2 * _PAD), np.float32)
    risks, best = np.empty((n, n), np.float32), np.empty((n, n), np.float32)
    for k in range(_STEPS - 1, -1, -1):
        _risks(movers, begin + (k + 0.5) * step, cell, room, risks)
        best[:] = np.float32(np.inf)
        _step_back(later, best, excess, stride)
        for i in range(n):
            for j in range(n):
                drives = best[i, j] + step * risks[i, j]
                stands = later[i + _PAD, j + _PAD] + step * (1.0 + STANDING * risks[i, j])
                best[i, j] = min(drives, stands)
        later[_PAD : n + _PAD, _PAD : n + _PAD] = best
        for p in range(_PAD):  # outside of the window it is as at its edge
            later[p], later[n + _PAD + p] = later[_PAD], later[n + _PAD - 1]
        for p in range(_PAD):
            later[:, p], later[:, n + _PAD + p] = later[:, _PAD], later[:, n + _PAD - 1]
    return best


class SpaceTime:
    """Solves the delays for one robot.

    Args:
        limits: Size and limits of the robot.
        begin: Time from now on from which delays are wanted [s].
        horizon: Time over which movers are predicted [s].
    """

    def __init__(self, limits: DriveLimits, begin: float, horizon: float = _HORIZON) -> None:
        self._beside = limits.room
        self._room = limits.gap + math.hypot(0.5 * limits.length, 0.5 * limits.width)
        self._begin, self._step = begin, (horizon - begin) / _STEPS
        self._cell = limits.speed * horizon / _HALF
        self._stride = limits.speed * self._step / self._cell

    def window(self, value: MapValue, pose: Array, movers: Array, points: Array) -> Window:
        """Return the delays around the robot.

        Args:
            value: Time to reach the goal.
            pose: Pose of the robot in the map frame (3,) [m, m, rad].
            movers: Predicted movers (m, 12) in the map frame.
            points: Echoes of what stands (n, 2) in the map frame [m].
        """
        cells = self._cell / value.map.resolution
        row, column = (value.map.to_grid(pose[:2]) - _HALF * cells).tolist()
        window = Window(NO_WINDOW.delays, row, column, cells)
        excess = np.empty((_DIRECTIONS, 2 * _HALF + 1, 2 * _HALF + 1), np.float32)
        there = np.ascontiguousarray(value.map.to_grid(points).reshape(-1, 2).T)
        excesses(value.times, window, there, self._beside / self._cell, self._step, self._stride, excess)
        around = placed(movers, float(pose[0]), float(pose[1]), value.map.origin[2])
        delays = solve_delays(excess, around, self._cell, self._room, self._begin, self._step, self._stride)
        return window._replace(delays=delays)
