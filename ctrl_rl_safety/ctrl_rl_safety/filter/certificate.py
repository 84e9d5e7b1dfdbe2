"""Certifies a command by simulating it until the next one can take effect, then an escape until the robot stops.

At each time step the robot, a disc or a rectangle, is checked against all inflated echoes. Half the distance covered
between two steps is added to the required clearance, so that the motion in between is covered too. A command is
certified if some escape leaves a margin of zero or more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.motion import STANDS, next_state
from ctrl_rl_safety.sets.distance_field import CAP, FAR, distance_to, margin_at, square_to
from ctrl_rl_safety.sets.recoverable_set import value_at

Array = NDArray[np.float64]

FAMILY = 5
"""Number of constant-turn-rate escapes; the one after them is given by the recoverable set."""
MOST_STEPS = 1000
_TURNS = 7
AWAY = 1e-3
"""Minimum gain in distance of a motion that starts too close to an obstacle [m]."""
_SLOPE = 0.1
"""The same relative to the way, for a slow motion."""
BAND = 0.08
"""Difference between two distances that noise may invert [m]; a motion must gain on all echoes within it."""


@njit(inline="always")
def outer_speed(v: float, omega: float, core: tuple[float, float]) -> float:
    """Return a bound on the speed of all points of the robot [m/s]; a rotating disc covers no new area."""
    return abs(v) + math.hypot(core[0], core[1]) * abs(omega)


@njit(inline="always")
def _checked(sit: Any, state: tuple[float, float, float, float, float], t: float) -> float:
    """Return the margin of a state; at rest, approaching obstacles are not counted."""
    x, y, theta, v, omega = state
    speed = outer_speed(v, omega, sit.core)
    slack = 0.5 * speed * sit.motion.step
    aside = sit.rooms[1] + slack if speed >= STANDS else -FAR
    return margin_at(sit.obstacles, sit.growth, sit.core, x, y, theta, t, (sit.rooms[0] + slack, aside))


@njit
def hold(
    sit: Any, state: tuple[float, float, float, float, float], t: float, v_c: float, omega_c: float, steps: int
) -> Any:
    """Return the state, the time and the minimum margin after holding a command for some steps."""
    least = FAR
    for _ in range(steps):
        x, y, theta, v, omega = state
        state = next_state(x, y, theta, v, omega, v_c, omega_c, sit.motion)
        t += sit.motion.step
        least = min(least, _checked(sit, state, t))
    return state, t, least


@njit
def best_turn(sit: Any, state: tuple[float, float, float, float, float]) -> float:
    """Return the turn rate whose next state has the highest value while braking [rad/s]."""
    best, most = 0.0, -FAR
    for k in range(_TURNS):
        turn = sit.turn_rate * (2.0 * k / (_TURNS - 1) - 1.0)
        x, y, theta, v, omega = state
        for _ in range(sit.hold):
            x, y, theta, v, omega = next_state(x, y, theta, v, omega, 0.0, turn, sit.motion)
        guide = sit.guide
        value = value_at(guide.values, guide.x, guide.y, guide.cell, guide.top, x, y, theta, v)
        value -= 1e-4 * abs(turn)
        if value > most:
            best, most = turn, value
    return best


@njit
def _escape_turn(
    sit: Any, state: tuple[float, float, float, float, float], kind: int, step: int, before: float
) -> float:
    """Return the turn rate to command in a step of an escape [rad/s]; a rectangle at rest also stops turning.

    The turn rate changes only when a new command may be sent, so that the robot can execute the certified escape.

    Args:
        sit: Motion model and set.
        state: State before the step.
        kind: Kind of the escape.
        step: Index of the step.
        before: Turn rate of the previous step [rad/s].
    """
    if step % sit.hold:
        return before
    if sit.core[0] > 0.0 and abs(state[3]) < STANDS:
        return 0.0
    if kind == FAMILY:
        return best_turn(sit, state)
    if kind == 0:
        return state[4] if step == 0 else before
    return sit.turn_rate * (2.0 * (kind - 1) / (FAMILY - 2) - 1.0)


@njit
def _escape(sit: Any, state: tuple[float, float, float, float, float], t: float, kind: int, floor: float) -> float:
    """Return the minimum margin of an escape, or any value below `floor` if it falls below."""
    turn = 0.0
    least = FAR
    for k in range(MOST_STEPS):
        x, y, theta, v, omega = state
        if outer_speed(v, omega, sit.core) < STANDS or least < floor:
            break
        turn = _escape_turn(sit, state, kind, k, turn)
        state = next_state(x, y, theta, v, omega, 0.0, turn, sit.motion)
        t += sit.motion.step
        least = min(least, _checked(sit, state, t))
    return min(least, _checked(sit, state, t) - outer_speed(state[3], state[4], sit.core) * sit.lag)


@njit
def _tried(kind: int, first: int, ready: bool) -> bool:
    """Return whether to try an escape besides the first one; a set replaces most of them."""
    if kind == first:
        return False
    return kind == FAMILY or kind == 0 if ready else kind < FAMILY


@njit
def escape_from(
    sit: Any, state: tuple[float, float, float, float, float], t: float, first: int, needed: float
) -> tuple[float, int]:
    """Return margin and kind of the first escape with the required margin, or else of the best one.

    If the required margin is attainable, an escape is abandoned as soon as it falls below it.
    """
    if first == FAMILY and not sit.guide.ready:
        first = 0
    best, which = _escape(sit, state, t, first, -FAR if needed >= FAR else needed), first
    for k in range(FAMILY + 1):
        if best >= needed:
            break
        kind = FAMILY - k
        if needed >= FAR or _tried(kind, first, sit.guide.ready):
            if kind == FAMILY and not sit.guide.ready:
                continue
            margin = _escape(sit, state, t, kind, best if needed >= FAR else needed)
            if margin > best:
                best, which = margin, kind
    return best, which


@njit
def nears(points: Any, begin: Any, end: Any, core: tuple[float, float]) -> bool:
    """Return whether a motion approaches any of the nearest echoes, including those that noise may reorder."""
    nearest = distance_to(points, begin[0], begin[1], begin[2], core) + BAND
    c, s, next_c, next_s = math.cos(begin[2]), math.sin(begin[2]), math.cos(end[2]), math.sin(end[2])
    for i in range(points.shape[1]):
        away = square_to(points, i, begin[0], begin[1], c, s, core)
        if away < nearest * nearest and square_to(points, i, end[0], end[1], next_c, next_s, core) < away:
            return True
    return False


@njit
def _gains(sit: Any, begin: tuple[float, float, float, float, float], end: Any) -> float:
    """Return the distance gained from static echoes [m]; zero if the motion approaches any of the nearest."""
    obstacles, core, rooms = sit.obstacles, sit.core, (sit.rooms[0], -FAR)
    gained = margin_at(obstacles, sit.growth, core, end[0], end[1], end[2], 0.0, rooms)
    gained -= margin_at(obstacles, sit.growth, core, begin[0], begin[1], begin[2], 0.0, rooms)
    if nears(obstacles.fixed, begin, end, core) or nears(obstacles.standing, begin, end, core):
        return min(gained, 0.0)
    return gained


@njit
def _certify_from(
    sit: Any,
    state: tuple[float, float, float, float, float],
    t: float,
    command: tuple[float, float],
    steps: int,
    first: int,
    needed: float,
) -> tuple[float, int]:
    """Return margin and escape of a command that has its first effect in one state, see `certify`."""
    end, later, least = hold(sit, state, t, command[0], command[1], steps)
    if sit.close and outer_speed(command[0], command[1], sit.core) > 0.0:  # creeping below STANDS would add up
        gained = _gains(sit, state, end)
        swept = math.hypot(end[0] - state[0], end[1] - state[1])
        swept += math.hypot(sit.core[0], sit.core[1]) * abs(end[2] - state[2])
        if gained < min(AWAY, _SLOPE * swept):
            return min(least, gained, 0.0) - AWAY, first
    if least < needed and least < 0.0:
        return least, first
    margin, kind = escape_from(sit, end, later, first, needed)
    return min(least, margin, CAP), kind


@njit
def certify(
    sit: Any,
    state: tuple[float, float, float, float, float],
    t: float,
    command: tuple[float, float],
    steps: int,
    first: int,
    needed: float,
) -> tuple[float, int]:
    """Return the margin of a command [m] and the kind of its escape.

    Commands that alternate turn a robot elsewhere if they act sooner than reckoned. Where the delay is known only
    within bounds, a command is therefore certified after the longest delay and after the shortest.

    Args:
        sit: Echoes, motion model and set.
        state: State when the command has its first effect.
        t: Age of the echoes at that time [s].
        command: Speed [m/s] and turn rate [rad/s].
        steps: Number of time steps for which the command is held.
        first: Kind of escape to try first.
        needed: Sufficient margin [m].
    """
    margin, kind = _certify_from(sit, state, t, command, steps, first, needed)
    if sit.sooner.differs and (margin >= 0.0 or needed >= FAR):
        other, _ = _certify_from(sit, sit.sooner.state, sit.sooner.t, command, steps, kind, needed)
        margin = min(margin, other)
    return margin, kind


@njit
def hopeless(sit: Any, state: tuple[float, float, float, float, float], command: tuple[float, float]) -> bool:
    """Return whether the recoverable set rules out any escape after a command, so that none need be tried."""
    guide = sit.guide
    if not guide.ready or sit.close:
        return False
    x, y, theta, v, omega = state
    for _ in range(sit.hold):
        x, y, theta, v, omega = next_state(x, y, theta, v, omega, command[0], command[1], sit.motion)
    if abs(v) < STANDS:
        return False
    return value_at(guide.values, guide.x, guide.y, guide.cell, guide.top, x, y, theta, v) < -0.5 * guide.cell


@cached_njit
def escape_path(sit: Any, state: Any, command: tuple[float, float], kind: int) -> Array:
    """Return the states (n, 5) of a command, then of its escape, until the robot stops.

    The turn rates in the states are the commanded ones.
    """
    out = np.empty((sit.hold + MOST_STEPS, 5))
    turn, count = command[1], 0
    while count < sit.hold or (count < len(out) and outer_speed(state[3], state[4], sit.core) >= STANDS):
        if count >= sit.hold:
            turn = _escape_turn(sit, state, kind, count - sit.hold, turn)
        x, y, theta, v, omega = state
        state = next_state(x, y, theta, v, omega, command[0] if count < sit.hold else 0.0, turn, sit.motion)
        out[count] = np.array((state[0], state[1], state[2], state[3], turn))
        count += 1
    return out[:count].copy()
