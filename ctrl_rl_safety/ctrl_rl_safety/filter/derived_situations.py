"""Situations derived from another one: a closer start, fewer echoes, a smaller robot, a second delay."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from ctrl_rl_safety.filter.certificate import AWAY
from ctrl_rl_safety.filter.manoeuvres import around, stopping_time
from ctrl_rl_safety.filter.situation import Situation
from ctrl_rl_safety.models.growth import Growth, fixed_growth, standing_growth
from ctrl_rl_safety.sets.distance_field import CAP, FAR, margin_at


@njit
def _changed(sit: Any, obstacles: Any, growth: Any, body: Any, close: bool, sooner: Any) -> Any:
    """Return a situation with other parts, `body` being core and rooms; compiled code has no `_replace`."""
    core, rooms = body
    return Situation(
        obstacles, growth, sit.motion, sit.guide, core, rooms, close, sit.hold, sit.turn_rate, sit.lag, sooner
    )


@njit
def after(sit: Any, sooner: Any) -> Any:
    """Return the situation of a robot whose commands may act sooner as well."""
    return _changed(sit, sit.obstacles, sit.growth, (sit.core, sit.rooms), sit.close, sooner)


@njit
def from_here(sit: Any, x: float, y: float, theta: float, t: float) -> Any:
    """Return the situation relative to the robot's present clearance, if that is less than required.

    The disturbance is then omitted: a robot at rest must be able to turn and to move to more open space.
    """
    room = sit.rooms[1]
    if margin_at(sit.obstacles, sit.growth, sit.core, x, y, theta, t, (room, -FAR)) >= 0.0:
        return sit
    growth = Growth(0.0, sit.growth.mover_speed, 0.0, 0.0)
    gap = margin_at(sit.obstacles, growth, sit.core, x, y, theta, 0.0, (room, -FAR))
    rooms = room + min(gap - 2.0 * AWAY, 0.0), room
    return _changed(sit, sit.obstacles, growth, (sit.core, rooms), True, sit.sooner)


@njit
def local(sit: Any, ask: Any, state: tuple[float, float, float, float, float], t: float) -> Any:
    """Return the situation without static echoes that the robot hardly comes near before it has stopped.

    Searching in it takes a fraction of the time. What is found is certified among all echoes.
    """
    longest = max(ask.patience, sit.hold) * sit.motion.step
    fastest = max(abs(state[3]), min(abs(state[3]) + ask.acceleration * longest, max(ask.fastest, -ask.slowest)))
    stop = stopping_time(fastest, ask.braking, sit.lag)
    way = fastest * (longest + sit.lag + 0.5 * stop + sit.motion.step)
    extent = sit.rooms[0] + math.hypot(sit.core[0], sit.core[1])
    grown = max(fixed_growth(t + longest + stop, sit.growth), standing_growth(t + longest + stop, sit.growth))
    near = around(sit.obstacles, state[0], state[1], way + extent + grown + 2.0 * CAP)
    return _changed(sit, near, sit.growth, (sit.core, sit.rooms), sit.close, sit.sooner)


@njit
def smaller(sit: Any, by: float) -> Any:
    """Return the situation of a robot that is smaller by a distance on each side [m]."""
    core, rooms = sit.core, sit.rooms
    if core[0] > 0.0:
        core = (max(core[0] - by, AWAY), max(core[1] - by, AWAY))
    else:
        rooms = (rooms[0] - by, rooms[1] - by)
    return _changed(sit, sit.obstacles, sit.growth, (core, rooms), sit.close, sit.sooner)
