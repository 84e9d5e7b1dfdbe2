"""Chooses a command by the value at the end of short roll-outs, which avoid the echoes of the last scan.

A candidate is a command that is held for a while, after which the robot drives straight on. Its cost is the time of its
roll-out, the time to reach from where it ends, and the time to turn there into the direction of the value's descent.
Commands change within the limits of acceleration. This is the optimal control of the value, over a finite set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values.jit_cache import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import EASE, SLOWEST, longest_time_beside
from ctrl_rl_navigation.values.map_value import MapValue, value_and_slopes

Array = NDArray[np.float64]

STEP = 0.1
"""Time step of a roll-out [s]."""
HORIZON = 1.6
"""Duration of a roll-out [s]."""
_HOLDS = (0.125, 0.3125, 0.625, 1.0)
"""Shares of the roll-out for which a candidate holds its command."""
_SPEEDS = (0.0, 0.35, 0.7, 1.0)
_TURNS = (-1.0, -0.7, -0.45, -0.25, -0.1, 0.0, 0.1, 0.25, 0.45, 0.7, 1.0)
"""Shares of the largest speed and turn rate that are tried."""
_NEARER = 1e-3
"""Distance by which an echo must come nearer to count [m]."""
_HIT_COST = 0.5
"""Cost of a roll-out that ends before an obstacle, besides the time that it then stands [s]."""
_CHANGE_COST = 0.02
"""Cost of turning the other way at the full rate [s], so that noise does not decide."""


class _Rules(NamedTuple):
    """Numbers of a roll-out in SI units."""

    speed: float
    turn_rate: float
    acceleration: float
    turn_acceleration: float
    gap: float
    half_length: float
    half_width: float
    delay: float
    braking: float
    ease: float
    slowest: float
    step: float
    steps: int


class _Place(NamedTuple):
    """A map's origin, direction and resolution, the robot's pose on it, and the goal's disc in the robot's frame.

    The disc's places from which more than `goal_time` is left lie behind a wall.
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
    """Return the time to reach, and the time to turn into its descent, at a pose in the robot's first frame [s]."""
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
def _beside(point: Any, time: float, x: float, y: float, c: float, s: float, rules: Any) -> float:
    """Return the square of an echo's distance to the core of the robot [m^2]: to its rectangle, or to its middle."""
    dx, dy = point[0] + time * point[2] - x, point[1] + time * point[3] - y
    along = max(abs(c * dx + s * dy) - rules.half_length, 0.0)
    aside = max(abs(c * dy - s * dx) - rules.half_width, 0.0)
    return along * along + aside * aside


@njit(inline="always")
def _gap(points: Any, now: Any, time: float, x: float, y: float, theta: float, rules: Any) -> tuple[float, bool]:
    """Return the distance to the nearest echo [m], and whether one that is too near has come nearer."""
    least, hit = np.inf, False
    c, s = math.cos(theta), math.sin(theta)
    for i in range(len(points)):
        square = _beside(points[i], time, x, y, c, s, rules)
        if square < least:
            least = square
        if square < rules.gap * rules.gap and math.sqrt(square) < now[i] - _NEARER:
            hit = True
    return math.sqrt(least), hit


@njit(inline="always")
def _cost(
    times: Any, place: Any, points: Any, now: Any, rules: Any, motion: tuple[float, float], candidate: Any
) -> float:
    """Return the cost of a candidate [s]; inf where the robot could not stop in time."""
    v, omega = motion
    x = y = theta = 0.0
    way = cost = committed = 0.0
    ends = rules.steps * rules.step
    for k in range(rules.steps):
        first = k * rules.step < candidate[2] - 1e-9
        v = _toward(v, candidate[0] if first else rules.speed, rules.acceleration * rules.step)
        omega = _toward(omega, candidate[1] if first else candidate[3], rules.turn_acceleration * rules.step)
        if k == 0:  # the robot decides anew after this step, and brakes from its speed at the latest
            committed = v * rules.delay + 0.5 * v * v / rules.braking
        middle = theta + 0.5 * omega * rules.step
        next_x, next_y = x + v * rules.step * math.cos(middle), y + v * rules.step * math.sin(middle)
        gap, hit = _gap(points, now, (k + 1) * rules.step, next_x, next_y, theta + omega * rules.step, rules)
        if hit:
            if way < committed:
                return np.inf
            cost += ends - k * rules.step + _HIT_COST
            break
        x, y, theta = next_x, next_y, theta + omega * rules.step
        way += abs(v) * rules.step
        near = min(max((gap - rules.gap) / rules.ease, 0.0), 1.0)
        cost += rules.step / (rules.slowest + (1.0 - rules.slowest) * near)
        if math.hypot(x - place.goal_x, y - place.goal_y) <= place.goal_radius:
            value, _ = _time_left(times, place, x, y, theta, rules.turn_rate)
            if value <= place.goal_time:
                return cost
    value, turn = _time_left(times, place, x, y, theta, rules.turn_rate)
    return cost + value + turn


@cached_njit
def _choose(
    times: Any, place: Any, points: Array, rules: Any, motion: tuple[float, float], candidates: Array
) -> tuple[int, float]:
    """Return the candidate of the least cost, -1 for none that is safe, and that cost [s]."""
    now = np.empty(len(points))
    for i in range(len(points)):
        now[i] = math.sqrt(_beside(points[i], 0.0, 0.0, 0.0, 1.0, 0.0, rules))
    best, least = -1, np.inf
    for i in range(len(candidates)):
        cost = _cost(times, place, points, now, rules, motion, candidates[i])
        cost += _CHANGE_COST * abs(candidates[i, 1] - motion[1]) / rules.turn_rate
        if cost < least:
            best, least = i, cost
    return best, least


@dataclass(frozen=True)
class Choice:
    """The look-ahead's answer.

    Attributes:
        command: Speed [m/s] and turn rate [rad/s] to send now (2,).
        cost: Time to reach the goal that it expects [s]; inf where no command is safe.
        plan: Speed [m/s] and turn rate [rad/s] that it holds, for how long [s], and the turn rate after that (4,).
    """

    command: Array
    cost: float
    plan: Array


class LookAhead:
    """Chooses commands for one robot.

    Args:
        limits: Size and limits of the robot.
        period: Time from command to command [s].
        delay: Time from a command to its effect, and until the next one [s].
        deceleration: Deceleration of the robot when it brakes [m/s^2].
        step: Time step of a roll-out [s].
        horizon: Duration of a roll-out [s].
        ease: Additional clearance from which on driving costs no more than its time [m].
        slowest: Share of the full speed that driving beside an obstacle is counted with.
        turns_after: Shares of the largest turn rate that are tried after a candidate's command; 0 is straight on.
        speeds: Shares of the largest speed that are tried; negative ones are backwards.
    """

    def __init__(
        self,
        limits: DriveLimits,
        period: float,
        delay: float,
        deceleration: float,
        step: float = STEP,
        horizon: float = HORIZON,
        ease: float = EASE,
        slowest: float = SLOWEST,
        turns_after: tuple[float, ...] = (0.0,),
        speeds: tuple[float, ...] = _SPEEDS,
    ) -> None:
        self.limits, self._period = limits, period
        self._rules = _Rules(
            limits.speed,
            limits.turn_rate,
            limits.acceleration,
            limits.turn_acceleration,
            limits.gap,
            0.5 * limits.length,
            0.5 * limits.width,
            delay,
            deceleration,
            ease,
            slowest,
            step,
            round(horizon / step),
        )
        held = [
            (speed * limits.speed, turn * limits.turn_rate, hold * horizon, after * limits.turn_rate)
            for speed in speeds
            for turn in _TURNS
            for hold in _HOLDS
            for after in (turns_after if hold < 1.0 else (0.0,))
            if turn != after or hold == 1.0
        ]
        self._candidates = np.array(held)
        self.reach = limits.speed * horizon + limits.gap + ease + math.hypot(0.5 * limits.length, 0.5 * limits.width)

    def choose(self, value: MapValue, pose: Array, command: Array, points: Array, plan: Array | None = None) -> Choice:
        """Return the command to send.

        Where the last choice's plan is given, the rest of it is a candidate too. A robot that waits for a moment as the
        best plan begins so then goes on with it, and does not begin to wait again and again.

        Args:
            value: Time to reach the goal.
            pose: Pose x, y, theta in the map's frame (3,) [m, m, rad].
            command: Command that was sent last (2,) [m/s, rad/s].
            points: Echoes in the robot's frame (n, 2) [m], or with their velocities (n, 4) [m, m, m/s, m/s].
            plan: Plan of the last choice (4,), one period ago; None for none.
        """
        origin = value.map.origin
        dx, dy = value.goal[0] - pose[0], value.goal[1] - pose[1]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        place = _Place(
            origin[0],
            origin[1],
            math.cos(origin[2]),
            math.sin(origin[2]),
            value.map.resolution,
            float(pose[0]),
            float(pose[1]),
            float(pose[2]),
            float(c * dx + s * dy),
            float(c * dy - s * dx),
            value.radius,
            longest_time_beside(value.radius, self.limits),
        )
        near = points[np.hypot(points[:, 0], points[:, 1]) < self.reach]
        if near.shape[1] == 2:
            near = np.hstack((near, np.zeros_like(near)))
        motion = (float(command[0]), float(command[1]))
        candidates = self._candidates if plan is None else np.vstack((self._candidates, self._rest(plan)))
        best, cost = _choose(value.times, place, np.ascontiguousarray(near), self._rules, motion, candidates)
        most = np.array((self.limits.acceleration, self.limits.turn_acceleration)) * self._period
        if best < 0:
            turn = float(np.clip(0.0, motion[1] - most[1], motion[1] + most[1]))
            return Choice(np.array((0.0, turn)), math.inf, np.zeros(4))
        return Choice(np.clip(candidates[best, :2], command - most, command + most), cost, candidates[best])

    def _rest(self, plan: Array) -> Array:
        """Return what is left of a plan (4,) after one period."""
        held = plan[2] - self._period
        horizon = self._rules.step * self._rules.steps
        return np.array((*plan[:2], held, plan[3]) if held > 1e-9 else (self.limits.speed, plan[3], horizon, 0.0))
