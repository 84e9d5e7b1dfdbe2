"""Moves a stationary robot out of the way of an approaching mover, using certified commands."""

from __future__ import annotations

from typing import Any

from ctrl_rl_core.values import cached_njit
from numba import njit

from ctrl_rl_safety.filter.certificate import certify, hold
from ctrl_rl_safety.filter.situation import Situation
from ctrl_rl_safety.models.growth import Growth, moving_growth
from ctrl_rl_safety.sets.distance_field import FAR, margin_at

AHEAD = 1.0
"""Time to a possible contact with a stationary robot at which evading starts [s]."""
LONGER = 1.4
"""The same time for a robot that is already evading, so that it does not stop immediately [s]."""
_ROLL_OUT = 0.5
"""Duration of the compared motions [s]."""
_LEAST_GAIN = 0.03
"""Minimum distance that evading must gain within that duration [m]."""
_TURNS = 7


@njit
def _to_movers(sit: Situation, state: tuple[float, float, float, float, float]) -> float:
    """Return the approximate distance to the nearest mover [m]."""
    x, y, theta, _, _ = state
    return margin_at(sit.obstacles, Growth(0.0, 0.0, 0.0, 0.0), sit.core, x, y, theta, 0.0, (-FAR, 0.0))


@cached_njit
def evade(sit: Any, state: Any, t: float, speeds: tuple[float, float], ahead: float) -> tuple[float, float, float, int]:
    """Return a certified command away from movers, with its margin and escape; margin < 0 for none.

    Args:
        sit: Echoes, motion model and set.
        state: State when the command has its first effect.
        t: Age of the echoes at that time [s].
        speeds: Minimum and maximum speed [m/s].
        ahead: Time to a possible contact with a mover at which the robot evades [s].
    """
    near = _to_movers(sit, state)
    v, omega, best, kind, most = 0.0, 0.0, -FAR, 0, _LEAST_GAIN
    if near - sit.rooms[1] - moving_growth(t + ahead, sit.growth) >= 0.0:
        return v, omega, best, kind
    steps = max(int(_ROLL_OUT / sit.motion.step), sit.hold)
    for i in range(2):
        for k in range(_TURNS):
            command = (speeds[i], sit.turn_rate * (2.0 * k / (_TURNS - 1) - 1.0))
            end, _, least = hold(sit, state, t, command[0], command[1], steps)
            gain = _to_movers(sit, end) - near
            if least < 0.0 or gain <= most:
                continue
            margin, escape = certify(sit, state, t, command, sit.hold, 0, 0.0)
            if margin >= 0.0:
                v, omega, best, kind, most = command[0], command[1], margin, escape, gain
    return v, omega, best, kind
