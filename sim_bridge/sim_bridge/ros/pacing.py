"""Paces the simulation by wall time: physics steps due, and the measured real-time factor."""

from __future__ import annotations

import math

LONGEST_GAP = 0.1
"""Maximum wall time to catch up [s]; the rest of a longer gap (a pause, a busy machine) is dropped."""


class Pacer:
    """Counts the physics steps due at a given real-time factor."""

    def __init__(self, rate: int) -> None:
        """Pace a world of `rate` physics steps per second [Hz]."""
        self._rate = rate
        self._last: float | None = None
        self._owed = 0.0

    def due(self, now: float, factor: float) -> int:
        """Return the number of steps due.

        Args:
            now: Steady wall time [s].
            factor: Real-time factor: simulation time per wall time.
        """
        gap = 0.0 if self._last is None else min(now - self._last, LONGEST_GAP)
        self._last = now
        self._owed += gap * factor * self._rate
        steps = int(self._owed)
        self._owed -= steps
        return steps

    def rest(self) -> None:
        """Discard the steps due, because the world is paused."""
        self._last, self._owed = None, 0.0


class SpeedMeter:
    """Measures the real-time factor between consecutive readings."""

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None

    def read(self, now: float, simulated: float) -> float:
        """Return the real-time factor since the last reading; NaN for the first reading.

        Args:
            now: Steady wall time [s].
            simulated: Simulation time [s].
        """
        begin, self._begin = self._begin, (now, simulated)
        if begin is None or now <= begin[0]:
            return math.nan
        return (simulated - begin[1]) / (now - begin[0])


class Schedule:
    """Schedules an event at a frequency in simulation time, given in physics steps, starting at step 0."""

    def __init__(self, frequency: float, rate: int) -> None:
        """Start at step 0.

        Args:
            frequency: Frequency [Hz], at most `rate`.
            rate: Physics steps per second [Hz].
        """
        self._period = max(1.0, rate / frequency)
        self._count = 0
        self.next = 0

    def due(self, step: int) -> bool:
        """Return whether the event is due at this step; if so, schedule the next one."""
        if step < self.next:
            return False
        self._count += 1
        self.next = math.ceil(self._count * self._period - 1e-9)
        return True
