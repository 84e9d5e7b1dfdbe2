"""The value of a state: the clearance that the best escape keeps until the quadrotor hovers. Compiled code.

An escape accelerates in one direction for a time and then brakes. It is simulated as flown, with all six states and
thrusts held for a tick. The clearance is reduced by the distance that any point of the body may move between two
checked positions, and after a time t by half the disturbance times t^2.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.flight.motion import State, escape_thrusts, moved, room_at

Array = NDArray[np.float64]

LOST = -1e3
"""Value of a state from which no escape reaches a hover [m]."""
LONGEST = 3.0
"""Time within which an escape must reach a hover [s]."""
_SHORTEST = 0.3  # duration of an escape [s], for a hovering quadrotor that is pushed towards a wall
_CHECKS = 2  # of the clearance, per tick
_SLOW, _LEVEL, _TURNS = 0.15, 0.1, 0.5  # a hover [m/s, rad, rad/s]: the remaining motion amounts to centimetres


_FAR_END = 1e-3  # fraction of the clearance at the end of an escape, up to 1 m, that counts as clearance on the way
_TICKS_IN_GOAL = 2  # depth inside the goal that a flight must reach, to be detected at 30 Hz


class KnownWorld(NamedTuple):
    """Known surroundings of the quadrotor.

    Attributes:
        shapes: Rows of `shape_rows` (k, 7).
        goal: Goal region, where the flight ends (9,): bounds of x, z and psi, centre and radius of a disc.
    """

    shapes: Array
    goal: Array


@njit
def _in_goal(goal: Array, state: State, off: float) -> bool:
    """Return whether a state is in the goal even if its position is wrong by up to `off` [m]."""
    x, z, psi = state[0], state[2], state[4]
    inside = goal[0] + off <= x <= goal[1] - off and goal[2] + off <= z <= goal[3] - off
    return inside and goal[4] <= psi <= goal[5] and math.hypot(x - goal[6], z - goal[7]) <= goal[8] - off


@njit
def _hovers(state: State) -> bool:
    return math.hypot(state[1], state[3]) < _SLOW and abs(state[4]) < _LEVEL and abs(state[5]) < _TURNS


@njit
def _room_for_tick(craft: Any, shapes: Array, state: State, t_1: float, t_2: float, room: float) -> Any:
    """Return the state after a tick, the clearance there, and the minimum clearance during the tick [m]."""
    seconds, least = craft.tick / _CHECKS, np.inf
    reach = math.hypot(craft.half_length, craft.half_height)
    for _ in range(_CHECKS):
        before = math.hypot(state[1], state[3]) + reach * abs(state[5])
        state = moved(craft, state, t_1, t_2, seconds)
        after = math.hypot(state[1], state[3]) + reach * abs(state[5])
        there = room_at(craft, shapes, state[0], state[2], state[4])
        least = min(least, 0.5 * (room + there - max(before, after) * seconds), there)
        room = there
    return state, room, least


@njit
def _escaped(
    craft: Any, world: KnownWorld, state: State, room: float, plan: Array, recorded: Array, enough: float, ahead: int
) -> Any:
    """Return the minimum clearance of an escape, or any value below `enough` if less, and the clearance at its end [m].

    Args:
        craft: Constants of the quadrotor, a `Craft`.
        world: Shapes and goal around it.
        state: State at the start of the escape.
        room: Clearance in that state [m].
        plan: Direction and duration of the acceleration (2,), after the recorded thrusts.
        recorded: Recorded thrusts at the start of the escape (n, 2).
        enough: Clearance below which the escape is useless [m].
        ahead: Number of ticks from now to that state.
    """
    least, inside, push_for, off = room, 0, plan[1], 0.0
    for tick in range(round(LONGEST / craft.tick)):
        if least < enough:
            return least, room
        if _hovers(state) and push_for <= 0.0 and tick * craft.tick >= _SHORTEST:
            return least, room
        inside = inside + 1 if _in_goal(world.goal, state, off) else 0
        if inside > _TICKS_IN_GOAL:
            return least, room
        if tick < len(recorded):
            t_1, t_2 = recorded[tick, 0], recorded[tick, 1]
        else:
            t_1, t_2 = escape_thrusts(craft, state, plan[0], push_for)
            push_for -= craft.tick
        state, room, on_way = _room_for_tick(craft, world.shapes, state, t_1, t_2, room)
        off = 0.5 * craft.disturbance * (craft.tick * (ahead + tick + 1)) ** 2
        least = min(least, on_way - off)
    return LOST, room


@cached_njit
def best_escape(craft: Any, world: KnownWorld, state: State, plans: Array, recorded: Array, enough: float) -> Any:
    """Return the value of a state, and the plan that attains it.

    Among plans with enough, or equally little, clearance, the one that ends with the most clearance is chosen.
    Otherwise a disturbance could slowly push a hovering quadrotor onto a wall, because no plan increases the present
    clearance.

    Args:
        craft: Constants of the quadrotor, a `Craft`.
        world: Shapes and goal around it.
        state: Current state.
        plans: Escapes (n, 2): direction [rad], and duration of the acceleration [s].
        recorded: Thrusts of one more escape, followed by braking (k, 2) [N].
        enough: Sufficient clearance [m].

    Returns:
        The maximum over the plans of the minimum clearance on the way to a hover or the goal [m], `LOST` if no escape
        reaches either; and the index of the plan, -1 for the recorded thrusts.
    """
    room = room_at(craft, world.shapes, state[0], state[2], state[4])
    value, best, score = LOST, 0, LOST
    for k in range(-1, len(plans)):
        if k >= 0:
            found, end = _escaped(craft, world, state, room, plans[k], recorded[:0], score - _FAR_END, 0)
        elif len(recorded):
            found, end = _escaped(craft, world, state, room, np.zeros(2), recorded, LOST, 0)
        else:
            continue
        its_score = min(found, enough) + _FAR_END * min(max(end, 0.0), 1.0)
        if its_score > score:
            value, best, score = found, k, its_score
    return value, best


@cached_njit
def nearest_safe(craft: Any, world: KnownWorld, state: State, thrusts: Array, plans: Array, enough: float) -> Any:
    """Return the first thrusts after which some plan keeps enough clearance.

    Args:
        craft: Constants of the quadrotor, a `Craft`.
        world: Shapes and goal around it.
        state: Current state.
        thrusts: Thrusts to try, each held for a tick (m, 2) [N].
        plans: Escapes (n, 2), see `best_escape`.
        enough: Required clearance [m].

    Returns:
        The index of the thrusts, -1 for none; the clearance [m]; the index of the plan; the state after the tick.
    """
    here = room_at(craft, world.shapes, state[0], state[2], state[4])
    none = thrusts[:0]
    for k in range(len(thrusts)):
        after, room, on_way = _room_for_tick(craft, world.shapes, state, thrusts[k, 0], thrusts[k, 1], here)
        on_way -= 0.5 * craft.disturbance * craft.tick * craft.tick
        if on_way < enough:
            continue
        for j in range(len(plans)):
            value, _ = _escaped(craft, world, after, room, plans[j], none, enough, 1)
            if value >= enough:
                return k, min(value, on_way), j, after
    return -1, LOST, 0, state


@cached_njit
def record(craft: Any, state: State, plan: Array) -> Array:
    """Return the thrusts of a plan (2,) from a state to a hover, one row per tick (k, 2) [N]."""
    out, push_for = np.empty((round(LONGEST / craft.tick), 2)), plan[1]
    for tick in range(len(out)):
        if _hovers(state) and push_for <= 0.0:
            return out[:tick]
        t_1, t_2 = escape_thrusts(craft, state, plan[0], push_for)
        push_for -= craft.tick
        out[tick, 0], out[tick, 1] = t_1, t_2
        for _ in range(_CHECKS):
            state = moved(craft, state, t_1, t_2, craft.tick / _CHECKS)
    return out
