"""Counts of one step: who commanded for how long, and how often the filter changed a command. Pure logic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.on_robot.environment.robot import Driven

Array = NDArray[np.float64]


class Tally:
    """Commands and answers since a step began.

    Attributes:
        late_scans: Number of scans that were too old on arrival, or out of order.
    """

    def __init__(self, now: float, command: Array) -> None:
        """Begin at a time [s] with the command (2,) that holds then."""
        self._since, self._command, self._by_operator = now, command, False
        self._sum, self._time, self._operator = np.zeros(2), 0.0, 0.0
        self._answers = self._changed = 0
        self.late_scans = 0

    def sent(self, now: float, command: Array, by_operator: bool) -> None:
        """Note a command (2,) that is sent at a time [s]."""
        self._add(now)
        self._command, self._by_operator = command, by_operator

    def answered(self, changed: bool) -> None:
        """Note an answer of the safety filter."""
        self._answers += 1
        self._changed += changed

    def end(self, now: float) -> Driven:
        """Return the step's commands at its end [s]."""
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
