"""Chooses the manoeuvre that serves a raw command best where the raw command itself is not certified.

The nearest certified command alone is short-sighted: the robot slows down and stops in front of a person whom it could
pass, or beside a door that it does not meet in the middle. So a family of short manoeuvres is tried: the robot turns to
some heading, drives on for a while, and turns to where the raw command wants to go. The one whose end is nearest to the
end of the raw command's own way is preferred. Certificates still decide which command is sent.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from ctrl_rl_safety.filter.detour import detour
from ctrl_rl_safety.models.motion import STANDS
from ctrl_rl_safety.sets.distance_field import FAR, Obstacles, margin_at

_WIDEST = math.radians(75.0)
"""Maximum rotation from the heading of the last passed command [rad]: a blocked way is no reason to drive somewhere
else."""
_HEADINGS = 17
_BEND = 1.8
"""Exponent that spaces the headings: they are densest around the robot's own."""
_SHARES = (0.3, 1.0)
"""Parts of the way that a manoeuvre drives at its first heading."""
_SPEEDS = (1.0, 0.5, 0.2)
"""Speeds of manoeuvres relative to the raw one; a slower robot turns within less way and needs less room. The slowest
begins with a turn on the spot."""
_AHEAD = 1.0
"""Time over which the raw command's aim is served [s]."""
_PLACES, _SWEEP = 12, 4
"""Number of places at which a manoeuvre is checked, and of headings where a rectangle turns on the spot."""
_THERE = math.radians(4.0)
"""Rotation up to which a turn on the spot counts as done [rad]."""
_LOOK = 0.5
"""Time for which the requested turn rate is interpreted as a desired heading [s]."""
_TURN_TIME = 0.25
"""Time in which the robot should reach a heading [s]."""
_LOSS = 0.001
"""Margin that a robot with less than it needs may lose on the way [m]."""
_SPARE = 0.03
"""Margin beyond which more is worth nothing [m]."""
_LACK_COST, _SLOW_COST, _TURN_COST = 6.0, 0.3, 0.02
"""Cost of a lack of margin [1], and of going slower and of turning, relative to the way [1, 1/rad]."""
_GAIN = 0.2
"""Part of the way by which a blocked manoeuvre must be better than the raw command to be preferred."""


class Way(NamedTuple):
    """The preferred manoeuvre.

    Attributes:
        v: Speed to begin with [m/s].
        omega: Turn rate to begin with [rad/s].
        clear: Whether nothing blocks it.
    """

    v: float
    omega: float
    clear: bool


@njit
def _within(points: Any, x: float, y: float, reach: float) -> Any:
    """Return the points (2, n) within a distance of a place [m]."""
    kept = np.empty_like(points)
    count = 0
    for i in range(points.shape[1]):
        dx, dy = points[0, i] - x, points[1, i] - y
        if dx * dx + dy * dy < reach * reach:
            kept[0, count], kept[1, count] = points[0, i], points[1, i]
            count += 1
    return kept[:, :count].copy()


@njit
def around(obstacles: Any, x: float, y: float, reach: float) -> Any:
    """Return the obstacles whose static echoes lie within a distance of a place [m], with the same grid."""
    fixed, standing = _within(obstacles.fixed, x, y, reach), _within(obstacles.standing, x, y, reach)
    grids = obstacles.to_fixed, obstacles.to_standing, obstacles.to_moving
    return Obstacles(fixed, standing, obstacles.moving, *grids, obstacles.x, obstacles.y, obstacles.cell)


@njit
def stopping_time(v: float, braking: float, lag: float) -> float:
    """Return the time of braking from a speed to rest [s]."""
    bend = max(braking * lag, STANDS)
    return max(v - bend, 0.0) / braking + lag * math.log(max(min(v, bend) / STANDS, 1.0))


@njit
def _drive(
    sit: Any,
    near: Any,
    begin: tuple[float, float, float],
    turns: tuple[float, float],
    change: float,
    speed: float,
    way: float,
    later: float,
    spot: bool,
) -> tuple[float, float, bool, float]:
    """Return where a manoeuvre ends, whether it is clear, and its mean lack of margin [m].

    Moving echoes are ignored, because the robot waits for them to pass.

    Args:
        sit: Echoes and motion model.
        near: Echoes around the robot.
        begin: Pose at the beginning.
        turns: Rotations to the first and to the second heading [rad].
        change: Way to the second heading [m].
        speed: Speed, less than 0 for reverse [m/s].
        way: Length of the manoeuvre [m].
        later: Time since the echoes were measured when the robot could have stopped [s].
        spot: Whether the robot turns to the first heading on the spot.
    """
    x, y, theta = begin
    step = way / _PLACES
    time = step / abs(speed)
    share, most, along = -math.expm1(-time / _TURN_TIME), sit.turn_rate * time, math.copysign(step, speed)
    rooms = (sit.rooms[0] + 0.5 * abs(speed) * sit.motion.step, -FAR)
    least = min(margin_at(near, sit.growth, sit.core, x, y, theta, later, rooms), 0.0) - _LOSS
    turned = lack = 0.0
    if spot:
        for k in range(1, _SWEEP + 1 if sit.core[0] > 0.0 else 1):
            at = theta + turns[0] * k / _SWEEP
            if margin_at(near, sit.growth, sit.core, x, y, at, later, rooms) < least:
                return x, y, False, 0.0
        turned = turns[0]
    for k in range(_PLACES):
        wanted = turns[0] if k * step < change else turns[1]
        turn = min(max(share * (wanted - turned), -most), most)
        middle = theta + turned + 0.5 * turn
        turned += turn
        next_x, next_y = x + along * math.cos(middle), y + along * math.sin(middle)
        margin = margin_at(near, sit.growth, sit.core, next_x, next_y, theta + turned, later, rooms)
        if margin < least:
            return x, y, False, lack / _PLACES
        lack += max(_SPARE - margin, 0.0)
        x, y = next_x, next_y
    return x, y, True, lack / _PLACES


@njit
def manoeuvre(sit: Any, ask: Any, state: tuple[float, float, float, float, float], t: float) -> Way:
    """Return the manoeuvre to prefer over the raw command.

    Args:
        sit: Echoes and motion model.
        ask: Requested command, and the rotation since one last passed.
        state: State when the command has its first effect.
        t: Age of the echoes at that time [s].
    """
    v, omega = ask.raw
    raw = Way(v, omega, False)
    if abs(v) < STANDS:
        return raw
    x, y, theta = state[0], state[1], state[2]
    until = t + ask.patience * sit.motion.step
    later = until + stopping_time(abs(v), ask.braking, sit.lag)
    if margin_at(sit.obstacles, sit.growth, sit.core, x, y, theta, later, (-FAR, sit.rooms[1])) < 0.0:
        return raw  # someone moves so close that waiting is the only option
    extent = sit.rooms[0] + math.hypot(sit.core[0], sit.core[1])
    way = _AHEAD * abs(v) + 2.0 * extent
    near = around(sit.obstacles, x, y, way + extent + _SPARE)
    if near.standing.shape[1] > 0:  # what may begin to move needs more room than a door has
        return Way(v, detour(sit, ask, state, t), False)
    wish = min(max(_LOOK * omega, -_WIDEST), _WIDEST)
    along = math.copysign(way, v)
    aim_x, aim_y = x + along * math.cos(theta + wish), y + along * math.sin(theta + wish)
    best, found, own = FAR, raw, FAR
    for f in range(len(_SPEEDS)):
        speed, spot = _SPEEDS[f] * v, f == len(_SPEEDS) - 1
        later = until + stopping_time(abs(speed), ask.braking, sit.lag)
        # A robot that was turned away to unblock it is not turned back.
        for k in range(_HEADINGS + 1 if abs(ask.turned) <= _WIDEST else 1):
            turn = wish
            if k > 0:
                place = 2.0 * (k - 1) / (_HEADINGS - 1) - 1.0
                turn = _WIDEST * math.copysign(abs(place) ** _BEND, place)
                if abs(turn + ask.turned) > _WIDEST:
                    continue
            for s in range(len(_SHARES) if k > 0 else 1):
                end_x, end_y, clear, lack = _drive(
                    sit, near, (x, y, theta), (turn, wish), _SHARES[s] * way, speed, way, later, spot
                )
                cost = math.hypot(end_x - aim_x, end_y - aim_y) + _LACK_COST * lack
                cost += way * (_SLOW_COST * (1.0 - _SPEEDS[f]) + _TURN_COST * (abs(turn - wish) + abs(turn)))
                if k == 0:
                    own = min(own, cost)
                if cost < best:
                    best = cost
                    begun = 0.0 if spot and abs(turn) > _THERE else speed
                    found = Way(begun, min(max(turn / _TURN_TIME, -sit.turn_rate), sit.turn_rate), clear)
        if found.clear:
            break
    return found if found.clear or best < own - _GAIN * way else raw
