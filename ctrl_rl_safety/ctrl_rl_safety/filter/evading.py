"""Moves a robot that would stand out of the way of a mover that comes near, where a certified command does."""

from __future__ import annotations

from typing import Any

from ctrl_rl_core.values import cached_njit
from numba import njit

from ctrl_rl_safety.filter.certificate import Situation, certify, hold
from ctrl_rl_safety.models.growth import Growth, moving_growth
from ctrl_rl_safety.sets.distance_field import FAR, margin_at

AHEAD = 1.0
"""Time within which a mover could touch a robot that stands, for it to begin to evade [s]."""
LONGER = 1.4
"""That time for a robot that evades already, so that it does not stop at once [s]."""
_ROLL_OUT = 0.5
"""Time of the motions that are compared [s]."""
_LEAST_GAIN = 0.03
"""Distance that evading must bring within that time [m]."""
_TURNS = 7


@njit
def _to_movers(sit: Situation, state: tuple[float, float, float, float, float]) -> float:
    """Return about the distance to the nearest mover [m]."""
    x, y, theta, _, _ = state
    return margin_at(sit.obstacles, Growth(0.0, 0.0, 0.0, 0.0), sit.core, x, y, theta, 0.0, (-FAR, 0.0))


@cached_njit
def evade(sit: Any, state: Any, t: float, speeds: tuple[float, float], ahead: float) -> tuple[float, float, float, int]:
    """Return a certified command away from movers, its margin, and its escape; a margin below zero for none.

    Args:
        sit: Echoes, motion and set.
        state: State when the command has its first effect.
        t: Age of the echoes then [s].
        speeds: Least and largest speed [m/s].
        ahead: Time within which a mover could touch the robot, for it to evade [s].
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
