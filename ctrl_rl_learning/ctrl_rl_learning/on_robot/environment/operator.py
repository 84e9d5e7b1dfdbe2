"""Operator take-over, and statistics of who commanded for how long in a step; pure logic without ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.on_robot.environment.robot import Driven

Array = NDArray[np.float64]


class JoyMapping(NamedTuple):
    """Indices of button and axes in a sensor_msgs/Joy.

    Attributes:
        button: Index of the dead man's button, which the operator must hold.
        speed: Index of the axis for the speed.
        turn: Index of the axis for the turn rate.
    """

    button: int
    speed: int
    turn: int


class Operator:
    """Commands from a joystick or keyboard.

    Attributes:
        refused: Number of messages without a valid command.
    """

    def __init__(self, timeout: float, low: Array, high: Array) -> None:
        """Start without an operator in control.

        Args:
            timeout: Age above which a command expires [s].
            low: Minimum speed [m/s] and turn rate [rad/s] (2,).
            high: Maximum speed [m/s] and turn rate [rad/s] (2,).
        """
        self._timeout, self._low, self._high = timeout, low, high
        self._command, self._heard = np.zeros(2), -math.inf
        self.refused = 0

    def on_command(self, speed: float, turn_rate: float, now: float) -> None:
        """Store a speed [m/s] and turn rate [rad/s] received at a time [s]."""
        command = np.array((speed, turn_rate))
        if not np.isfinite(command).all():
            self.refused += 1
            return
        self._command, self._heard = np.clip(command, self._low, self._high), now

    def on_joy(self, axes: Sequence[float], buttons: Sequence[int], mapping: JoyMapping, now: float) -> None:
        """Handle a joystick state; releasing the dead man's button returns control at once."""
        if mapping.button >= len(buttons) or max(mapping.speed, mapping.turn) >= len(axes):
            self.refused += 1
            return
        if not buttons[mapping.button]:
            self._heard = -math.inf
            return
        tilt = np.clip((axes[mapping.speed], axes[mapping.turn]), -1.0, 1.0)
        speed, turn_rate = np.where(tilt >= 0.0, tilt * self._high, -tilt * self._low).tolist()
        self.on_command(speed, turn_rate, now)

    def command(self, now: float) -> Array | None:
        """Return the operator's command (2,) at a time [s]; None while no operator is in control."""
        return self._command if 0.0 <= now - self._heard <= self._timeout else None


class Tally:
    """Statistics of commands and filter outputs since a step began.

    Attributes:
        late_scans: Number of scans that were too old on arrival or out of order.
    """

    def __init__(self, now: float, command: Array) -> None:
        """Start at a time [s] with the command (2,) in effect at that time."""
        self._since, self._command, self._by_operator = now, command, False
        self._sum, self._time, self._operator = np.zeros(2), 0.0, 0.0
        self._answers = self._changed = 0
        self.late_scans = 0

    def sent(self, now: float, command: Array, by_operator: bool) -> None:
        """Record a command (2,) sent at a time [s]."""
        self._add(now)
        self._command, self._by_operator = command, by_operator

    def answered(self, changed: bool) -> None:
        """Record whether the safety filter changed a command."""
        self._answers += 1
        self._changed += changed

    def end(self, now: float) -> Driven:
        """Return the step's commands, given the time at its end [s]."""
        self._add(now)
        if self._time <= 0.0:
            return Driven(self._command, float(self._by_operator), 0.0)
        return Driven(self._sum / self._time, self._operator / self._time, self._changed / max(self._answers, 1))

    def _add(self, now: float) -> None:
        passed = max(now - self._since, 0.0)
        self._since = now
        self._sum += passed * self._command
        self._time += passed
        self._operator += passed * self._by_operator
