"""Roll-outs of a car's candidate commands, with its accelerations and the speed of its steering.

A candidate holds a speed and a curvature for some time, and then others. All last equally long, so a candidate that
waits gains nothing; only those that brake to a stop at the goal are shorter. A candidate counts if the car's rectangle
touches nothing all along, nor while it brakes to a stop from its end: so there is always a plan to go on with. Its cost
is its duration and the time to reach from its end, with what a speed below the full one costs there.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
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
    step.
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


class Grid(NamedTuple):
    """A grid in the plane of a roll-out: the position of its first cell, its direction there, and its cell [m].

    Positions are given in the frame of the robot at its start.
    """

    x: float
    y: float
    yaw: float
    cell: float


class Arrival(NamedTuple):
    """The goal in the frame of the robot at the start of a roll-out.

    Attributes:
        x: Position [m].
        y: Position [m].
        heading: Heading [rad].
        radius: Distance from the position within which the car has arrived [m].
        tolerance: Difference from the heading within which it has [rad].
    """

    x: float
    y: float
    heading: float
    radius: float
    tolerance: float


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
    heading -= headings * math.floor(heading / headings)
    return float(time_at(times, gear, heading, row, column))


@njit(inline="always")
def _terminal(times: Any, grid: Any, rules: Any, x: float, y: float, theta: float, v: float) -> float:
    """Return the time to reach from the end of a roll-out [s]."""
    if abs(v) < _STILL:
        return min(_time_left(times, grid, 0, x, y, theta), _time_left(times, grid, 1, x, y, theta))
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
def _next(rules: Any, state: Any, acts: bool, wanted: float, angle: float) -> Any:
    """Return x, y, heading, speed, speed asked for, and steering angle after a step.

    The speed [m/s] and the steering angle [rad] that a candidate wants count from when it acts.
    """
    x, y, theta, v, asked, steering = state
    if acts:
        slower = wanted * asked < 0.0 or abs(wanted) < abs(asked)
        most = (rules.braking if slower else rules.acceleration) * rules.step
        asked = min(max(wanted, asked - most), asked + most)
        turn = rules.steering_rate * rules.step
        steering += min(max(rules.steering_share * (angle - steering), -turn), turn)
    v += rules.speed_share * (asked - v)
    omega = v * math.tan(steering) / rules.wheelbase
    middle = theta + 0.5 * omega * rules.step
    x += v * rules.step * math.cos(middle)
    y += v * rules.step * math.sin(middle)
    return x, y, theta + omega * rules.step, v, asked, steering


@njit(inline="always")
def _is_free(fields: Any, places: Any, shapes: Any, x: float, y: float, theta: float) -> bool:
    for layer in range(2):
        row, column = _place(places[layer], x, y)
        if not fits(fields[layer], row, column, theta - places[layer].yaw, shapes[layer]):
            return False
    return True


@njit
def _can_go(fields: Any, places: Any, shapes: Any, rules: Any, track: Any, state: Any) -> bool:
    """Return whether the car touches nothing at the poses of a track (n, 3), nor while it brakes from its end.

    It brakes with its steering as it is.
    """
    for k in range(len(track)):
        if not _is_free(fields, places, shapes, track[k, 0], track[k, 1], track[k, 2]):
            return False
    for _ in range(rules.most):
        if abs(state[3]) < _STILL:
            break
        state = _next(rules, state, True, 0.0, state[5])
        if not _is_free(fields, places, shapes, state[0], state[1], state[2]):
            return False
    return True


@njit
def _cost(
    times: Any, grid: Any, arrival: Any, rules: Any, motion: Any, candidate: Any, track: Any
) -> tuple[float, int, Any]:
    """Return the cost of a candidate [s], the number of its poses, which are filled in, and the state at its end."""
    asked, v, steering = motion
    state = (0.0, 0.0, 0.0, v, asked, steering)
    stop = candidate[STOPS]
    elapsed, count = 0.0, 0
    while count < (rules.most if stop < math.inf else round(candidate[END] / rules.step)):
        first, over = elapsed < candidate[HOLD] - 1e-9, elapsed >= stop - 1e-9
        if over and abs(state[3]) < _STILL:
            break
        wanted = 0.0 if over else candidate[SPEED] if first else candidate[SPEED_AFTER]
        angle = math.atan(rules.wheelbase * (candidate[CURVATURE] if first else candidate[CURVATURE_AFTER]))
        state = _next(rules, state, elapsed >= rules.delay - 1e-9, wanted, angle)
        track[count, 0], track[count, 1], track[count, 2] = state[0], state[1], state[2]
        count += 1
        elapsed = count * rules.step
    x, y, theta, v, _, _ = state
    if stop == math.inf:
        return elapsed + _terminal(times, grid, rules, x, y, theta, v), count, state
    there = math.hypot(x - arrival.x, y - arrival.y) <= arrival.radius
    turned = (theta - arrival.heading + math.pi) % (2.0 * math.pi) - math.pi
    return elapsed if there and abs(turned) <= arrival.tolerance else math.inf, count, state


@cached_njit
def choose(
    times: Any,
    grid: Any,
    arrival: Any,
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
        arrival: Where candidates may stop.
        fields: Distances to the obstacles of the map, and to those of the last scan (rows, columns) [cells].
        places: Where these lie.
        shapes: The car's rectangle in the cells of each.
        rules: Parameters of a roll-out.
        motion: Speed asked for [m/s], speed [m/s] and steering angle [rad] at the start.
        candidates: Candidates (n, 7), see `SPEED` etc.
        favour: Amount by which the first one may cost more [s].
    """
    best, least, track = -1, math.inf, np.empty((rules.most, 3))
    for number in range(len(candidates)):
        candidate = candidates[number]
        cost, count, end = _cost(times, grid, arrival, rules, motion, candidate, track)
        turned = abs(math.atan(rules.wheelbase * candidate[CURVATURE]) - motion[2])
        cost += _CHANGE_COST * turned / rules.steering_angle - (favour if number == 0 else 0.0)
        # Most cost more than the best so far, so the obstacles, which take the most time, come last.
        if cost < least and _can_go(fields, places, shapes, rules, track[:count], end):
            best, least = number, cost
    return best, least
