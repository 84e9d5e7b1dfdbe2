"""Roll-outs of candidate commands: their duration, clearance, and the time to reach from their end."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.people.movers import STANDING, holds, risk, spread
from ctrl_rl_navigation.values.map_value import value_and_slopes

Array = NDArray[np.float64]

_NEARER = 1e-3
"""Distance by which an echo must come closer to count [m]."""
_HIT_COST = 0.5
"""Cost of a roll-out that ends at an obstacle, in addition to the standing time [s]."""
_BACKWARDS_COST = 0.5
"""Cost of going on backwards after a roll-out, instead of turning [s]."""
_SOON, _SURE = 0.5, 2.0
"""Time within which nothing but standing averts a contact any more [s], and how much more that one counts in motion."""
_STANDS = 0.02
"""Speed below which a robot stands [m/s]."""
_CHANGE_COST = 0.02
"""Cost of reversing the turn direction at the full rate [s], so that noise does not decide."""


class Rules(NamedTuple):
    """Parameters of a roll-out in SI units."""

    speed: float
    reverse_speed: float
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
    along: bool
    """Whether the value is that of a corridor around a path."""


@njit(inline="always")
def _toward(value: float, wanted: float, most: float) -> float:
    return min(max(wanted, value - most), value + most)


@njit(inline="always")
def _cell(place: Any, x: float, y: float) -> tuple[float, float]:
    """Return row and column of a position in the first frame."""
    c, s = math.cos(place.robot_theta), math.sin(place.robot_theta)
    along, aside = place.robot_x + c * x - s * y - place.x, place.robot_y + s * x + c * y - place.y
    column = (place.cos * along + place.sin * aside) / place.resolution - 0.5
    return (place.cos * aside - place.sin * along) / place.resolution - 0.5, column


@njit(inline="always")
def _time_left(
    times: Any, window: Any, place: Any, x: float, y: float, theta: float, rules: Any
) -> tuple[float, float]:
    """Return the time to reach past people, and the time to turn into its descent, at a pose in the first frame [s]."""
    row, column = _cell(place, x, y)
    value, by_row, by_column = value_and_slopes(times, row, column)
    if len(window.delays) > 0 and value < np.inf:
        i, j = (row - window.row) / window.cells, (column - window.column) / window.cells
        delay, delay_by_row, delay_by_column = value_and_slopes(window.delays, i, j)
        value += delay
        by_row += delay_by_row / window.cells
        by_column += delay_by_column / window.cells
    if not value > 0.0 or value == np.inf or by_row * by_row + by_column * by_column == 0.0:
        return value, 0.0
    down = math.atan2(-by_row, -by_column) + math.atan2(place.sin, place.cos)
    turn = down - (place.robot_theta + theta)
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    seconds = abs(turn) / rules.turn_rate
    if rules.reverse_speed > 0.0 and len(window.delays) > 0:  # it need not turn to make room
        seconds = min(seconds, math.pi / rules.turn_rate - seconds + _BACKWARDS_COST)
    return value, seconds


@njit(inline="always")
def _beside(dx: float, dy: float, c: float, s: float, rules: Any) -> float:
    """Return the squared distance from a point to the robot's core [m^2]: its rectangle or its centre."""
    along = max(abs(c * dx + s * dy) - rules.half_length, 0.0)
    aside = max(abs(c * dy - s * dx) - rules.half_width, 0.0)
    return along * along + aside * aside


@njit(fastmath=True)
def _squares(points: Any, x: float, y: float, out: Any) -> None:
    """Fill in the squared distances to the robot's centre (n,) [m^2]; a separate loop, so that it is vectorised."""
    for i in range(len(out)):
        dx, dy = points[0, i] - x, points[1, i] - y
        out[i] = dx * dx + dy * dy


@njit(inline="always")
def _gap(points: Any, now: Any, x: float, y: float, theta: float, rules: Any, squares: Any) -> tuple[float, bool]:
    """Return the distance of the nearest echo to the robot's centre [m], and whether a too close one gets closer.

    The time to reach is computed from the centre's clearance. A cost based on the rectangle's clearance would exceed
    it, which would make waiting seem better than driving.
    """
    _squares(points, x, y, squares)
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
                away = math.sqrt(_beside(points[0, i] - x, points[1, i] - y, c, s, rules))
                if away < rules.gap and away < now[i] - _NEARER:
                    return math.sqrt(least), True
    return math.sqrt(least), False


@njit(inline="always")
def _contact_cost(movers: Any, time: float, x: float, y: float, theta: float, rules: Any) -> float:
    """Return the cost of a second among movers (m, 12) in the first frame [s/s]."""
    c, s, cost = math.cos(theta), math.sin(theta), 0.0
    for m in range(len(movers)):
        if not holds(movers, m, time):
            continue
        dx, dy = movers[m, 0] + time * movers[m, 2] - x, movers[m, 1] + time * movers[m, 3] - y
        away = math.sqrt(_beside(dx, dy, c, s, rules))
        cost += movers[m, 8] * risk(away, movers[m, 4] + rules.gap, spread(movers, m, time))
    return cost


@njit(inline="always")
def _slowness(times: Any, place: Any, x: float, y: float, rules: Any) -> float:
    """Return how many times longer than at full speed the value says that a metre takes: by its slope, |grad T|.

    Beside a path the value rises steeply; a roll-out that did not pay for that would cut every corner.
    """
    row, column = _cell(place, x, y)
    value, by_row, by_column = value_and_slopes(times, row, column)
    if not 0.0 < value < np.inf:
        return 1.0
    return math.hypot(by_row, by_column) * rules.speed / place.resolution


@njit(inline="always")
def _cost(
    times: Any,
    window: Any,
    place: Any,
    points: Any,
    now: Any,
    movers: Any,
    rules: Any,
    motion: Any,
    candidate: Any,
    squares: Any,
) -> float:
    """Return the cost of a candidate [s]; inf if the robot could not stop in time."""
    v, omega = motion
    x = y = theta = 0.0
    way = cost = committed = 0.0
    stopped = False
    corner = math.hypot(rules.half_length, rules.half_width)  # corners move even in a pure rotation
    for k in range(rules.steps):
        time = (k + 1) * rules.step
        if not stopped:
            first = k * rules.step < candidate[2] - 1e-9
            v = _toward(v, candidate[0] if first else rules.speed, rules.acceleration * rules.step)
            omega = _toward(omega, candidate[1] if first else candidate[3], rules.turn_acceleration * rules.step)
            if k == 0:  # the robot decides again after this step, and can then brake from its speed
                fastest = abs(v) + corner * abs(omega)
                committed = fastest * rules.delay + 0.5 * fastest * fastest / rules.braking
            middle = theta + 0.5 * omega * rules.step
            next_x, next_y = x + v * rules.step * math.cos(middle), y + v * rules.step * math.sin(middle)
            gap, stopped = _gap(points, now, next_x, next_y, theta + omega * rules.step, rules, squares)
            if stopped:
                if way < committed:
                    return np.inf
                v, cost = 0.0, cost + _HIT_COST
        if stopped:
            cost += rules.step
        else:
            x, y, theta = next_x, next_y, theta + omega * rules.step
            way += (abs(v) + corner * abs(omega)) * rules.step
            near = min(max((gap - rules.room) / rules.ease, 0.0), 1.0)
            spent = rules.step / (rules.slowest + (1.0 - rules.slowest) * near)
            if place.along:
                spent = max(spent, rules.step * _slowness(times, place, x, y, rules))
            cost += spent
        share = STANDING if abs(v) < _STANDS else _SURE if time < _SOON else 1.0
        cost += rules.step * share * _contact_cost(movers, time, x, y, theta, rules)
        if math.hypot(x - place.goal_x, y - place.goal_y) <= place.goal_radius:
            value, _ = _time_left(times, window, place, x, y, theta, rules)
            if value <= place.goal_time:
                return cost
    value, turn = _time_left(times, window, place, x, y, theta, rules)
    return cost + value + turn


@cached_njit
def choose(
    times: Any,
    window: Any,
    place: Any,
    points: Array,
    movers: Array,
    rules: Any,
    motion: tuple[float, float],
    candidates: Array,
) -> tuple[int, float]:
    """Return the index of the safe candidate with the lowest cost, -1 if none is safe, and its cost [s].

    Args:
        times: Times to reach on the map [s].
        window: Delays that movers cause, at the end of a roll-out.
        place: Pose of the robot, goal and geometry of the map.
        points: Echoes of what stands in the robot's frame (2, n) [m].
        movers: Predicted movers in the robot's frame (m, 12).
        rules: Size and limits of the robot.
        motion: Current speed [m/s] and turn rate [rad/s].
        candidates: Speed [m/s], turn rate [rad/s], hold time [s] and subsequent turn rate [rad/s] (k, 4).
    """
    now, squares = np.empty(points.shape[1]), np.empty(points.shape[1])
    for i in range(len(now)):
        now[i] = math.sqrt(_beside(points[0, i], points[1, i], 1.0, 0.0, rules))
    best, least = -1, np.inf
    for i in range(len(candidates)):
        cost = _cost(times, window, place, points, now, movers, rules, motion, candidates[i], squares)
        cost += _CHANGE_COST * abs(candidates[i, 1] - motion[1]) / rules.turn_rate
        if cost < least:
            best, least = i, cost
    return best, least
