"""Certifies a car's command by simulating it until the next one can take effect, then braking along the present arc.

A car cannot turn on the spot, and its front wheels stay as they are while it brakes, so there is one escape. At each
time step the rectangle is checked against all inflated echoes; half the way of its outermost point between two steps is
added to the required clearance, so that the motion in between is covered too.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.filter.certificate import AWAY, MOST_STEPS, nears
from ctrl_rl_safety.models.car_model import Steered, next_of_car
from ctrl_rl_safety.models.growth import Growth, fixed_growth, moving_growth, standing_growth
from ctrl_rl_safety.models.motion import STANDS, Motion
from ctrl_rl_safety.sets.distance_field import CAP, FAR, Obstacles, margin_at

Array = NDArray[np.float64]

_SLOPE = 0.1
"""Minimum gain in distance of a motion that starts too close to an obstacle, relative to its way."""


class CarSituation(NamedTuple):
    """All inputs of a car's certificate.

    Attributes:
        obstacles: Echoes with their distances on a grid.
        growth: Bounds of motion.
        motion: Changes of the speed in a time step.
        car: Steering in a time step.
        core: Half the length and width of the rectangle [m].
        room: Required distance from the rectangle to an echo [m].
        lag: Time constant of the speed [s].
    """

    obstacles: Obstacles
    growth: Growth
    motion: Motion
    car: Steered
    core: tuple[float, float]
    room: float
    lag: float


@njit(inline="always")
def _middle(sit: Any, state: Any) -> tuple[float, float]:
    """Return the position of the rectangle's middle [m]."""
    return state[0] + sit.car.centre * math.cos(state[2]), state[1] + sit.car.centre * math.sin(state[2])


@njit(inline="always")
def _fastest(sit: Any, state: Any) -> float:
    """Return the speed of the rectangle's outermost point [m/s]."""
    farthest = math.hypot(sit.car.centre + sit.core[0], sit.core[1])
    return float(abs(state[3]) * (1.0 + farthest * abs(math.tan(state[4])) / sit.car.wheelbase))


@njit
def _bound(sit: Any, x: float, y: float, theta: float, t: float, rooms: tuple[float, float]) -> float:
    """Return a lower bound of the margin [m], from the grid's distances at squares that make up the rectangle."""
    obstacles, growth, (half_length, half_width) = sit.obstacles, sit.growth, sit.core
    parts = max(1, round(half_length / half_width))
    extent = math.hypot(half_length / parts, half_width)
    stays, stands = rooms[0] + fixed_growth(t, growth), rooms[0] + standing_growth(t, growth)
    moves, least = rooms[1] + moving_growth(t, growth), FAR
    for part in range(parts):
        along = (2.0 * part + 1.0 - parts) * half_length / parts
        column = (x + along * math.cos(theta) - obstacles.x) / obstacles.cell
        row = (y + along * math.sin(theta) - obstacles.y) / obstacles.cell
        j, i = math.floor(column + 0.5), math.floor(row + 0.5)
        if not (0 <= i < len(obstacles.to_fixed) and 0 <= j < len(obstacles.to_fixed)):
            return -FAR
        away = math.hypot(column - j, row - i) * obstacles.cell + extent
        nearest = min(obstacles.to_fixed[i, j] - stays, obstacles.to_standing[i, j] - stands)
        least = min(least, nearest - away, obstacles.to_moving[i, j] - moves - away)
    return least


@njit
def car_margin(sit: Any, state: Any, t: float, room: float) -> float:
    """Return the margin of a state at a time since the scan [s]; at rest, approaching obstacles are not counted."""
    x, y = _middle(sit, state)
    speed = _fastest(sit, state)
    slack = room + 0.5 * speed * sit.motion.step
    rooms = (slack, slack if speed >= STANDS else -FAR)
    bound = _bound(sit, x, y, state[2], t, rooms)
    return bound if bound >= CAP else margin_at(sit.obstacles, sit.growth, sit.core, x, y, state[2], t, rooms)


@njit
def _braked(sit: Any, state: Any, t: float, room: float, needed: float) -> Any:
    """Return the state and minimum margin of braking to a stop; any margin below `needed` if it falls below."""
    least = FAR
    for _ in range(MOST_STEPS):
        if abs(state[3]) < STANDS or least < needed:
            break
        state = next_of_car(state, 0.0, 0.0, sit.motion, sit.car)
        t += sit.motion.step
        least = min(least, car_margin(sit, state, t, room))
    return state, min(least, car_margin(sit, state, t, room) - _fastest(sit, state) * sit.lag)


@njit
def certify_car(sit: Any, state: Any, t: float, command: tuple[float, float], steps: int, needed: float) -> float:
    """Return the margin of a command that is held for some steps, and then braked [m].

    A car that stands too close to an obstacle, by an error of a scan, may move away from all that are near.

    Args:
        sit: Echoes and motion model.
        state: State when the command has its first effect: x, y, heading, speed and steering angle.
        t: Age of the echoes at that time [s].
        command: Speed [m/s] and turn rate [rad/s].
        steps: Number of time steps.
        needed: Sufficient margin [m].
    """
    room, growth, gap = sit.room, sit.growth, FAR
    if abs(state[3]) < STANDS and abs(command[0]) >= STANDS:
        gap = car_margin(sit, state, t, room)
        if gap < 0.0:
            still = Growth(0.0, growth.mover_speed, 0.0, 0.0)
            sit = CarSituation(sit.obstacles, still, sit.motion, sit.car, sit.core, room, sit.lag)
            gap = car_margin(sit, state, 0.0, room)
            room += min(gap - 2.0 * AWAY, 0.0)
    begin, least = state, FAR
    for _ in range(steps):
        state = next_of_car(state, command[0], command[1], sit.motion, sit.car)
        t += sit.motion.step
        least = min(least, car_margin(sit, state, t, room))
        if least < min(needed, 0.0):
            return least
    state, braked = _braked(sit, state, t, room, needed)
    if gap < 0.0:
        way = math.hypot(state[0] - begin[0], state[1] - begin[1])
        first, last = (*_middle(sit, begin), begin[2]), (*_middle(sit, state), state[2])
        gained = car_margin(sit, state, 0.0, sit.room) - gap
        if nears(sit.obstacles.fixed, first, last, sit.core) or nears(sit.obstacles.standing, first, last, sit.core):
            gained = min(gained, 0.0)
        if gained < min(AWAY, _SLOPE * way):
            return min(least, braked, gained, 0.0) - AWAY
    return min(least, braked, CAP)


@cached_njit
def answer_car(sit: Any, begin: Array, t: float, commands: Array, tried: Array, steps: Any, needed: Any) -> Any:
    """Return the index of the first certified command, the margin, and the state when it has its first effect.

    If none is certified, the index is that of the last command, which must be braking.

    Args:
        sit: Echoes and motion model.
        begin: State from odometry (5,).
        t: Age of the echoes at that state [s].
        commands: Commands in each time step until a new one takes effect (n, 2).
        tried: Commands to try, in turn (m, 2).
        steps: Number of time steps for which each is held (m,).
        needed: Margin that each needs (m,) [m].
    """
    state = (begin[0], begin[1], begin[2], begin[3], begin[4])
    first = FAR
    for k in range(len(commands)):
        state = next_of_car(state, commands[k, 0], commands[k, 1], sit.motion, sit.car)
        t += sit.motion.step
        first = min(first, car_margin(sit, state, t, sit.room))
    margin = -FAR
    for k in range(len(tried)):
        margin = certify_car(sit, state, t, (tried[k, 0], tried[k, 1]), steps[k], needed[k])
        if margin >= needed[k]:
            return k, min(margin, first), state
    return len(tried) - 1, min(margin, first), state


@cached_njit
def car_path(sit: Any, begin: Array, command: tuple[float, float], steps: int) -> Array:
    """Return the states (n, 5) of a command that is held for some steps, and then braked; its middle's positions."""
    out = np.empty((steps + MOST_STEPS, 5))
    state, count = (begin[0], begin[1], begin[2], begin[3], begin[4]), 0
    while count < steps or (count < len(out) and abs(state[3]) >= STANDS):
        v, omega = command if count < steps else (0.0, 0.0)
        state = next_of_car(state, v, omega, sit.motion, sit.car)
        x, y = _middle(sit, state)
        out[count] = np.array((x, y, state[2], state[3], state[4]))
        count += 1
    return out[:count].copy()
