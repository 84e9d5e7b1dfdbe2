"""Turns a robot blocked by the filter towards the side with more room, so that it does not get stuck."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_safety.models.motion import STANDS

Array = NDArray[np.float64]

_HEADINGS = np.radians(np.arange(-180.0, 180.0, 5.0))
_BESIDE = 2
"""Number of headings to either side that count equally; at a touching wall, noise would block the robot again."""
_FARTHEST = 1.0
"""Clearance beyond which more does not matter [m]."""
_TURN_COST = 0.15
"""Clearance that must be gained per radian of rotation [m]."""
_THERE = math.radians(5.0)
_GAIN = 2.0
"""Gain from the remaining angle to the turn rate, as a fraction of the unblocking rate [1/rad]."""


class Unblocking:
    """Measures how long a robot is blocked, and chooses a heading.

    Args:
        after: Blocked time after which the robot is turned [s]; 0 for never.
    """

    def __init__(self, after: float) -> None:
        self._after = after
        self._held_since: float | None = None
        self._heading: float | None = None

    def note(self, now: float, command: tuple[float, float], wanted: tuple[float, float], v: float) -> None:
        """Record a command sent in place of the requested one, at a steady time [s]."""
        held = abs(v) < STANDS and abs(command[0]) < STANDS and abs(wanted[0]) >= STANDS
        if self._heading is not None and abs(wanted[0]) >= STANDS:
            return
        if not held:
            self._held_since = self._heading = None
        elif self._held_since is None:
            self._held_since = now

    def turn(self, now: float, wanted: tuple[float, float], state: Array, echoes: Array, room: float) -> float:
        """Return the rotation to make, from -1 to 1, or 0 for none.

        Args:
            now: Steady time [s].
            wanted: Requested command [m/s, rad/s].
            state: State of the robot in the frame of the echoes (5,).
            echoes: Static echoes (2, n) [m].
            room: Radius required by the robot [m].
        """
        if self._after <= 0.0 or abs(wanted[0]) < STANDS:
            self._heading = None
            return 0.0
        if self._heading is None:
            if self._held_since is None or now - self._held_since < self._after:
                return 0.0
            self._heading = freest_heading(state, math.copysign(1.0, wanted[0]), echoes, room)
        left = math.remainder(self._heading - float(state[2]), 2.0 * math.pi)
        if abs(left) < _THERE:
            self._heading = self._held_since = None
            return 0.0
        return math.copysign(max(min(_GAIN * abs(left), 1.0), 0.3), left)


def freest_heading(state: Array, sense: float, echoes: Array, room: float) -> float:
    """Return the heading with the most room around it, the nearest one if several are equal [rad].

    Args:
        state: State of the robot (5,).
        sense: Driving direction: 1.0 for forwards, -1.0 for backwards.
        echoes: Echoes in the state's frame (2, n) [m].
        room: Radius required by the robot [m].
    """
    dx, dy = echoes[0] - state[0], echoes[1] - state[1]
    rooms = np.full(len(_HEADINGS), _FARTHEST)
    for k, turn in enumerate(_HEADINGS.tolist()):
        c, s = math.cos(state[2] + turn), math.sin(state[2] + turn)
        along = sense * (c * dx + s * dy)
        aside = np.abs(c * dy - s * dx)
        ahead = (aside < room) & (along > 0.0)
        if ahead.any():
            free = float(np.min(along[ahead] - np.sqrt(room * room - aside[ahead] ** 2)))
            rooms[k] = min(free, _FARTHEST)
    around = np.mean([np.roll(rooms, k) for k in range(-_BESIDE, _BESIDE + 1)], axis=0)
    return float(state[2] + _HEADINGS[np.argmax(around - _TURN_COST * np.abs(_HEADINGS))])
