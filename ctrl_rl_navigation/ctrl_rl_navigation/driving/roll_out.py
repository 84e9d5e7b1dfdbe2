"""Roll-outs of candidate commands: their duration, clearance, and the time to reach from their end."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.values.map_value import value_and_slopes

Array = NDArray[np.float64]

_NEARER = 1e-3
"""Distance by which an echo must come closer to count [m]."""
_HIT_COST = 0.5
"""Cost of a roll-out that ends at an obstacle, in addition to the standing time [s]."""
_CHANGE_COST = 0.02
"""Cost of reversing the turn direction at the full rate [s], so that noise does not decide."""


class Rules(NamedTuple):
    """Parameters of a roll-out in SI units."""

    speed: float
    turn_rate: float
    acceleration: float
    turn_acceleration: float
    room: float
    gap: float
    half_length: float
    half_width: float
    delay: float
    braking: float
    ease: float
    slowest: float
    step: float
    steps: int


class Place(NamedTuple):
    """Map origin, direction and resolution, the robot's pose on the map, and the goal disc in the robot's frame.

    Parts of the disc with a time to reach above `goal_time` lie behind a wall.
    """

    x: float
    y: float
    cos: float
    sin: float
    resolution: float
    robot_x: float
    robot_y: float
    robot_theta: float
    goal_x: float
    goal_y: float
    goal_radius: float
    goal_time: float


@njit(inline="always")
def _toward(value: float, wanted: float, most: float) -> float:
    return min(max(wanted, value - most), value + most)


@njit(inline="always")
def _time_left(times: Any, place: Any, x: float, y: float, theta: float, turn_rate: float) -> tuple[float, float]:
    """Return the time to reach plus the time to turn into its descent, at a pose in the robot's first frame [s]."""
    c, s = math.cos(place.robot_theta), math.sin(place.robot_theta)
    along, aside = place.robot_x + c * x - s * y - place.x, place.robot_y + s * x + c * y - place.y
    column = (place.cos * along + place.sin * aside) / place.resolution - 0.5
    row = (place.cos * aside - place.sin * along) / place.resolution - 0.5
    value, by_row, by_column = value_and_slopes(times, row, column)
    if not value > 0.0 or value == np.inf or by_row * by_row + by_column * by_column == 0.0:
        return value, 0.0
    down = math.atan2(-by_row, -by_column) + math.atan2(place.sin, place.cos)
    turn = down - (place.robot_theta + theta)
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    return value, abs(turn) / turn_rate


@njit(inline="always")
def _beside(points: Any, i: int, time: float, x: float, y: float, c: float, s: float, rules: Any) -> float:
    """Return the squared distance from an echo to the robot's core [m^2]: its rectangle or its centre."""
    dx, dy = points[0, i] + time * points[2, i] - x, points[1, i] + time * points[3, i] - y
    along = max(abs(c * dx + s * dy) - rules.half_length, 0.0)
    aside = max(abs(c * dy - s * dx) - rules.half_width, 0.0)
    return along * along + aside * aside


@njit(fastmath=True)
def _squares(points: Any, time: float, x: float, y: float, out: Any) -> None:
    """Fill in the squared distances to the robot's centre (n,) [m^2]; a separate loop, so that it is vectorised."""
    for i in range(len(out)):
        dx, dy = points[0, i] + time * points[2, i] - x, points[1, i] + time * points[3, i] - y
        out[i] = dx * dx + dy * dy


@njit(inline="always")
def _gap(
    points: Any, now: Any, time: float, x: float, y: float, theta: float, rules: Any, squares: Any
) -> tuple[float, bool]:
    """Return the distance of the nearest echo to the robot's centre [m], and whether a too close one gets closer.

    The time to reach is computed from the centre's clearance. A cost based on the rectangle's clearance would exceed
    it, which would make waiting seem better than driving.
    """
    _squares(points, time, x, y, squares)
    least, odd, even = np.inf, np.inf, len(squares) // 2 * 2
    for i in range(0, even, 2):  # two independent minima, to hide the latency of each
        least, odd = min(least, squares[i]), min(odd, squares[i + 1])
    for i in range(even, len(squares)):
        least = min(least, squares[i])
    least = min(least, odd)
    reach = rules.gap + math.hypot(rules.half_length, rules.half_width)
    if least < reach * reach:
        c, s = math.cos(theta), math.sin(theta)
        for i in range(len(squares)):
            if squares[i] < reach * reach:
                away = math.sqrt(_beside(points, i, time, x, y, c, s, rules))
                if away < rules.gap and away < now[i] - _NEARER:
                    return math.sqrt(least), True
    return math.sqrt(least), False


@njit(inline="always")
def _cost(
    times: Any, place: Any, points: Any, now: Any, rules: Any, motion: Any, candidate: Any, squares: Any
) -> float:
    """Return the cost of a candidate [s]; inf if the robot could not stop in time."""
    v, omega = motion
    x = y = theta = 0.0
    way = cost = committed = 0.0
    ends = rules.steps * rules.step
    corner = math.hypot(rules.half_length, rules.half_width)  # corners move even in a pure rotation
    for k in range(rules.steps):
        first = k * rules.step < candidate[2] - 1e-9
        v = _toward(v, candidate[0] if first else rules.speed, rules.acceleration * rules.step)
        omega = _toward(omega, candidate[1] if first else candidate[3], rules.turn_acceleration * rules.step)
        if k == 0:  # the robot decides again after this step, and can then brake from its speed
            fastest = abs(v) + corner * abs(omega)
            committed = fastest * rules.delay + 0.5 * fastest * fastest / rules.braking
        middle = theta + 0.5 * omega * rules.step
        next_x, next_y = x + v * rules.step * math.cos(middle), y + v * rules.step * math.sin(middle)
        gap, hit = _gap(points, now, (k + 1) * rules.step, next_x, next_y, theta + omega * rules.step, rules, squares)
        if hit:
            if way < committed:
                return np.inf
            cost += ends - k * rules.step + _HIT_COST
            break
        x, y, theta = next_x, next_y, theta + omega * rules.step
        way += (abs(v) + corner * abs(omega)) * rules.step
        near = min(max((gap - rules.room) / rules.ease, 0.0), 1.0)
        cost += rules.step / (rules.slowest + (1.0 - rules.slowest) * near)
        if math.hypot(x - place.goal_x, y - place.goal_y) <= place.goal_radius:
            value, _ = _time_left(times, place, x, y, theta, rules.turn_rate)
            if value <= place.goal_time:
                return cost
    value, turn = _time_left(times, place, x, y, theta, rules.turn_rate)
    return cost + value + turn


@cached_njit
def choose(
    times: Any, place: Any, points: Array, rules: Any, motion: tuple[float, float], candidates: Array
) -> tuple[int, float]:
    """Return the index of the safe candidate with the lowest cost, -1 if none is safe, and its cost [s]."""
    now, squares = np.empty(points.shape[1]), np.empty(points.shape[1])
    for i in range(len(now)):
        now[i] = math.sqrt(_beside(points, i, 0.0, 0.0, 0.0, 1.0, 0.0, rules))
    best, least = -1, np.inf
    for i in range(len(candidates)):
        cost = _cost(times, place, points, now, rules, motion, candidates[i], squares)
        cost += _CHANGE_COST * abs(candidates[i, 1] - motion[1]) / rules.turn_rate
        if cost < least:
            best, least = i, cost
    return best, least
