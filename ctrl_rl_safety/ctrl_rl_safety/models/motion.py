"""The motion of a `RobotModel` in time steps; compiled code shared by filter, sets, tests and trials."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ctrl_rl_safety.models.robot_model import RobotModel

Array = NDArray[np.float64]

STANDS = 0.01
"""Speed below which a robot counts as stationary [m/s]."""


class Motion(NamedTuple):
    """Changes of the speeds within one time step.

    Attributes:
        step: Time step [s].
        share: Fraction of the difference to the command that is covered in a step.
        faster: Maximum change of the speed away from zero [m/s].
        slower: Maximum change of the speed towards zero [m/s].
        turn: Maximum change of the turn rate [rad/s].
        half_track: Half the distance between two wheels that share these limits [m]; 0 if the limits are independent.
    """

    step: float
    share: float
    faster: float
    slower: float
    turn: float
    half_track: float = 0.0


def motion_of(model: RobotModel, step: float) -> Motion:
    """Return the motion of a model for a time step [s]."""
    share = -math.expm1(-step / model.lag) if model.lag > 0.0 else 1.0
    changes = model.acceleration * step, model.braking * step, model.turn_acceleration * step
    return Motion(step, share, *changes, 0.5 * model.track)


@njit(inline="always")
def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most)


@njit(inline="always")
def _by_wheels(dv: float, turned: float, most: float, most_turn: float, half_track: float) -> tuple[float, float]:
    """Return the changes of speed [m/s] and turn rate [rad/s] nearest to requested ones for wheels of limited force.

    At full force, both wheels together change the speed by `most`, or against each other the turn rate by `most_turn`.
    A wheel below its limit reaches its target speed regardless of the other one.
    """
    left, right = dv / most - turned / most_turn, dv / most + turned / most_turn
    coupling = (most - most_turn * half_track) / (most + most_turn * half_track)
    if abs(left) >= abs(right):
        own = _limited(left, 1.0)
        left, right = own, _limited(right + coupling * (left - own), 1.0)
    else:
        own = _limited(right, 1.0)
        left, right = _limited(left + coupling * (right - own), 1.0), own
    return 0.5 * most * (right + left), 0.5 * most_turn * (right - left)


@njit(inline="always")
def next_speeds(v: float, omega: float, v_c: float, omega_c: float, motion: Any) -> tuple[float, float]:
    """Return speed [m/s] and turn rate [rad/s] after a step; a reversal brakes to zero first."""
    dv, turned = motion.share * (v_c - v), motion.share * (omega_c - omega)
    most = motion.slower if v * dv < 0.0 else motion.faster
    if motion.half_track > 0.0:
        dv, turned = _by_wheels(dv, turned, most, motion.turn, motion.half_track)
    else:
        dv, turned = _limited(dv, most), _limited(turned, motion.turn)
    return 0.0 if v * (v + dv) < 0.0 else v + dv, omega + turned


@njit(inline="always")
def next_state(
    x: float, y: float, theta: float, v: float, omega: float, v_c: float, omega_c: float, motion: Any
) -> tuple[float, float, float, float, float]:
    """Return the state after a step: the speeds change first, and the pose moves by their means."""
    faster, turned = next_speeds(v, omega, v_c, omega_c, motion)
    way, turn = 0.5 * (v + faster) * motion.step, 0.5 * (omega + turned) * motion.step
    middle = theta + 0.5 * turn
    return x + way * math.cos(middle), y + way * math.sin(middle), theta + turn, faster, turned
