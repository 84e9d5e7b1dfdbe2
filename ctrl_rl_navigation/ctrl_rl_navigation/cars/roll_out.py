"""Roll-outs of a car's candidate commands, with its accelerations and the speed of its steering.

A candidate holds a speed and a curvature for some time, and then others. All last equally long, so a candidate that
waits gains nothing; only those that brake to a stop at the goal are shorter. A candidate counts if the car's rectangle
touches nothing all along. Its cost is its duration and the time to reach from its end, with what a speed below the full
one costs there.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.cars.car_value import time_at
from ctrl_rl_navigation.cars.footprint import fits

SPEED, CURVATURE, HOLD, SPEED_AFTER, CURVATURE_AFTER, STOPS, END = range(7)
"""Columns of a candidate: the speed [m/s], negative in reverse; the curvature [1/m]; for how long [s]; speed and
curvature from then on; when the car brakes [s], inf for never; and the duration of a candidate that does not [s]."""
_STILL = 0.01
_CHANGE_COST = 0.02
"""Cost of turning the steering from stop to stop [s], so that noise does not decide."""


class Rules(NamedTuple):
    """Parameters of a roll-out in SI units.

    Speeds are forward and in reverse; shares are those by which speed and steering angle approach their commands in a
    step; `near` is the time to reach of a stop.
    """

    speeds: tuple[float, float]
    acceleration: float
    braking: float
    wheelbase: float
    steering_angle: float
    steering_rate: float
    change: float
    delay: float
    speed_share: float
    steering_share: float
    step: float
    most: int
    near: float


class Grid(NamedTuple):
    """A grid in the plane of a roll-out: the position of its first cell, its direction there, and its cell [m].

    Positions are given in the frame of the robot at its start.
    """

    x: float
    y: float
    yaw: float
    cell: float


@njit(inline="always")
def _place(grid: Any, x: float, y: float) -> tuple[float, float]:
    """Return row and column of a point."""
    c, s = math.cos(grid.yaw), math.sin(grid.yaw)
    dx, dy = x - grid.x, y - grid.y
    return (c * dy - s * dx) / grid.cell, (c * dx + s * dy) / grid.cell


@njit(inline="always")
def _time_left(times: Any, grid: Any, gear: int, x: float, y: float, theta: float) -> float:
    headings = times.shape[1]
    heading = (theta - grid.yaw) / (2.0 * math.pi) * headings
    row, column = _place(grid, x, y)
    return float(time_at(times, gear, heading - headings * math.floor(heading / headings), row, column))


@njit(inline="always")
def _terminal(times: Any, grid: Any, rules: Any, x: float, y: float, theta: float, v: float) -> float:
    """Return the time to reach from the end of a roll-out [s]."""
    gear = 0 if v > 0.0 else 1
    full = rules.speeds[gear]
    left = _time_left(times, grid, gear, x, y, theta)
    missing = max(full - abs(v), 0.0)
    cost = left + 0.5 * missing * missing / (rules.acceleration * full)
    beyond = 0.5 * v * v / rules.braking - left * full
    if beyond > 0.0:  # it cannot stop at the goal any more
        cost += rules.change + 2.0 * beyond / rules.speeds[1 - gear]
    return cost


@njit(inline="always")
def _cost(
    times: Any, grid: Any, fields: Any, places: Any, shapes: Any, rules: Any, motion: Any, candidate: Any
) -> float:
    """Return the cost of a candidate [s]; inf if the car touches something."""
    asked, v, steering = motion
    x = y = theta = 0.0
    stop = candidate[STOPS]
    elapsed = 0.0
    for number in range(rules.most if stop < math.inf else round(candidate[END] / rules.step)):
        elapsed = number * rules.step
        first, over = elapsed < candidate[HOLD] - 1e-9, elapsed >= stop - 1e-9
        if over and abs(v) < _STILL:
            break
        if elapsed >= rules.delay - 1e-9:
            wanted = 0.0 if over else candidate[SPEED] if first else candidate[SPEED_AFTER]
            slower = wanted * asked < 0.0 or abs(wanted) < abs(asked)
            most = (rules.braking if slower else rules.acceleration) * rules.step
            asked = min(max(wanted, asked - most), asked + most)
            angle = math.atan(rules.wheelbase * (candidate[CURVATURE] if first else candidate[CURVATURE_AFTER]))
            turn = rules.steering_rate * rules.step
            steering += min(max(rules.steering_share * (angle - steering), -turn), turn)
        v += rules.speed_share * (asked - v)
        omega = v * math.tan(steering) / rules.wheelbase
        middle = theta + 0.5 * omega * rules.step
        x += v * rules.step * math.cos(middle)
        y += v * rules.step * math.sin(middle)
        theta += omega * rules.step
        elapsed += rules.step
        for layer in range(2):
            row, column = _place(places[layer], x, y)
            if not fits(fields[layer], row, column, theta - places[layer].yaw, shapes[layer]):
                return math.inf
    if stop == math.inf:
        return elapsed + _terminal(times, grid, rules, x, y, theta, v)
    left = min(_time_left(times, grid, 0, x, y, theta), _time_left(times, grid, 1, x, y, theta))
    return elapsed + left if left <= rules.near else math.inf


@cached_njit
def choose(
    times: Any,
    grid: Any,
    fields: tuple[Any, Any],
    places: Any,
    shapes: Any,
    rules: Any,
    motion: tuple[float, float, float],
    candidates: NDArray[Any],
    favour: float,
) -> tuple[int, float]:
    """Return the index of the candidate with the lowest cost, -1 if each touches something, and its cost [s].

    Args:
        times: Times by gear, heading, row and column (2, H, R, C) [s].
        grid: Where their grid lies.
        fields: Distances to the obstacles of the map, and to those of the last scan (rows, columns) [cells].
        places: Where these lie.
        shapes: The car's rectangle in the cells of each.
        rules: Parameters of a roll-out.
        motion: Speed asked for [m/s], speed [m/s] and steering angle [rad] at the start.
        candidates: Candidates (n, 7), see `SPEED` etc.
        favour: Amount by which the first one may cost more [s].
    """
    best, least = -1, math.inf
    for number in range(len(candidates)):
        candidate = candidates[number]
        cost = _cost(times, grid, fields, places, shapes, rules, motion, candidate)
        turned = abs(math.atan(rules.wheelbase * candidate[CURVATURE]) - motion[2])
        cost += _CHANGE_COST * turned / rules.steering_angle - (favour if number == 0 else 0.0)
        if cost < least:
            best, least = number, cost
    return best, least
