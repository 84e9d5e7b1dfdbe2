"""The motion of a `RobotModel` in time steps, as machine code that filter, sets, tests and trials share."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from ctrl_rl_core.values.jit_cache import cached_njit
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.robot_model import RobotModel

Array = NDArray[np.float64]

STANDS = 0.01
"""Speed below which a robot counts as standing [m/s]."""


class Motion(NamedTuple):
    """Changes of the speeds within one time step.

    Attributes:
        step: Time step [s].
        share: Part of the difference to the command that goes within a step.
        faster: Largest change of the speed away from zero [m/s].
        slower: Largest change of the speed towards zero [m/s].
        turn: Largest change of the turn rate [rad/s].
    """

    step: float
    share: float
    faster: float
    slower: float
    turn: float


def motion_of(model: RobotModel, step: float) -> Motion:
    """Return the motion of a model for a time step [s]."""
    share = -math.expm1(-step / model.lag) if model.lag > 0.0 else 1.0
    return Motion(step, share, model.acceleration * step, model.braking * step, model.turn_acceleration * step)


@njit(inline="always")
def next_speed(v: float, wanted: float, motion: Any) -> float:
    """Return the speed after a step [m/s]; on the way to the other direction it brakes first."""
    change = motion.share * (wanted - v)
    if v * change < 0.0:
        change = min(max(change, -motion.slower), motion.slower)
        return v + change if abs(change) <= abs(v) else 0.0
    return v + min(max(change, -motion.faster), motion.faster)


@njit(inline="always")
def next_turn(omega: float, wanted: float, motion: Any) -> float:
    """Return the turn rate after a step [rad/s]."""
    return omega + min(max(motion.share * (wanted - omega), -motion.turn), motion.turn)


@njit(inline="always")
def next_state(
    x: float, y: float, theta: float, v: float, omega: float, v_c: float, omega_c: float, motion: Any
) -> tuple[float, float, float, float, float]:
    """Return the state after a step: speeds first change, the pose moves by their means."""
    faster, turned = next_speed(v, v_c, motion), next_turn(omega, omega_c, motion)
    way, turn = 0.5 * (v + faster) * motion.step, 0.5 * (omega + turned) * motion.step
    middle = theta + 0.5 * turn
    return x + way * math.cos(middle), y + way * math.sin(middle), theta + turn, faster, turned


@cached_njit
def roll_out(state: Array, commands: Array, motion: Any) -> Array:
    """Return the states (n + 1, 5) under commands (n, 2) from a state (5,), one for each time step."""
    out = np.empty((len(commands) + 1, 5))
    out[0] = state
    for k in range(len(commands)):
        x, y, theta, v, omega = out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4]
        out[k + 1] = np.array(next_state(x, y, theta, v, omega, commands[k, 0], commands[k, 1], motion))
    return out
