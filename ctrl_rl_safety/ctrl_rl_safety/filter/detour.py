"""Chooses a turn rate that leads the robot around obstacles in the path of the requested command.

The nearest certified command alone is short-sighted: the robot slows down and stops in front of a person whom it could
pass. The detour only changes the preferred command; certificates still decide which command is sent.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from ctrl_rl_safety.models.motion import STANDS
from ctrl_rl_safety.sets.distance_field import FAR, margin_at

_HEADINGS = 31
_WIDEST = math.radians(75.0)
"""Maximum rotation from the heading of the last passed command [rad]: a blocked way is no reason to drive somewhere
else."""
_AHEAD = 1.5
"""Time for which the path along a heading must be free [s]."""
_PLACES = 8
_LOOK = 0.5
"""Time for which the requested turn rate is interpreted as a desired heading [s]."""
_OWN = 0.5
"""Weight of the rotation from the robot's heading relative to that from the requested one; keeps the chosen side."""
_TURN_TIME = 0.4
"""Time in which the robot should reach the heading [s]."""
_LOSS = 0.01
"""Margin that may be lost on the way because of noisy echoes [m]."""
_TURN_COST = 0.015
"""Margin that must be gained per radian of rotation [m]."""


@njit
def _room(sit: Any, state: tuple[float, float, float, float, float], t: float, heading: float, way: float) -> float:
    """Return the mean margin of a straight path, capped at zero [m]; -FAR if the path gets too close.

    Moving echoes are ignored, because the robot waits for them to pass.
    """
    x, y, theta = state[0], state[1], state[2]
    c, s, rooms = math.cos(heading), math.sin(heading), (sit.rooms[0], -FAR)
    least = min(margin_at(sit.obstacles, sit.growth, sit.core, x, y, theta, t, rooms), 0.0) - _LOSS
    total = 0.0
    for k in range(1, _PLACES + 1):
        along = way * k / _PLACES
        margin = margin_at(sit.obstacles, sit.growth, sit.core, x + c * along, y + s * along, heading, t, rooms)
        if margin < least:
            return -FAR
        total += min(margin, 0.0)
    return total / _PLACES


@njit
def detour(sit: Any, ask: Any, state: tuple[float, float, float, float, float], t: float) -> float:
    """Return the turn rate to prefer over the raw command's [rad/s], or the raw one if there is no way past.

    Args:
        sit: Echoes and motion model.
        ask: Requested command, and the rotation since one last passed.
        state: State when the command has its first effect.
        t: Age of the echoes at that time [s].
    """
    v, omega = ask.raw
    if abs(v) < STANDS or abs(ask.turned) > _WIDEST:
        return omega
    later = t + sit.hold * sit.motion.step + abs(v) / ask.braking + sit.lag
    x, y, theta = state[0], state[1], state[2]
    if margin_at(sit.obstacles, sit.growth, sit.core, x, y, theta, later, (-FAR, sit.rooms[1])) < 0.0:
        return omega  # someone moves so close that waiting is the only option
    wish = min(max(_LOOK * omega, -_WIDEST), _WIDEST)
    best, most = 0.0, -FAR
    for k in range(_HEADINGS):
        turn = _WIDEST * (2.0 * k / (_HEADINGS - 1) - 1.0) - ask.turned
        room = _room(sit, state, later, state[2] + turn, _AHEAD * v)
        score = room - _TURN_COST * (abs(turn - wish) + _OWN * abs(turn))
        if score > most:
            best, most = turn, score
    if most <= -0.5 * FAR or abs(best - wish) <= 2.0 * _WIDEST / (_HEADINGS - 1):
        return omega
    return min(max(best / _TURN_TIME, -sit.turn_rate), sit.turn_rate)
