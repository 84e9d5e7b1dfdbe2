"""The time of an event on three clocks. No ROS.

Silence is measured on a steady clock, which nobody sets. The duration of an option is measured in the time of the world
in which it runs, because a simulation may be faster than the wall, or paused. Messages are stamped by the ROS clock,
which may be set at any time.
"""

from __future__ import annotations

from typing import NamedTuple

_LARGEST_LEAP = 10.0
_LARGEST_SPEED = 100.0


class ClockReading(NamedTuple):
    """The time of an event on three clocks [s].

    Attributes:
        steady: Steady clock, for leases, time-outs and repetitions.
        task: Time that has passed in the robots' world, as `TaskTime` measures it, for the durations of options.
        stamp: ROS clock, for the stamps of messages.
    """

    steady: float
    task: float
    stamp: float


class TaskTime:
    """Time that passes in the robots' world [s]: from 0, never backwards, and not where a clock is set.

    Without simulated time it is steady time. With it, steps back, and steps ahead of more than 10 s that are more than
    100 times as long as the wall's, are taken for a clock that was set: no time passes then.

    Attributes:
        jumps: Number of times that the clock was set.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._passed = 0.0
        self._read: tuple[bool, float, float] | None = None

    def __call__(self, stamp: float, steady: float, simulated: bool) -> float:
        """Return the time that has passed.

        Args:
            stamp: ROS's clock [s].
            steady: Steady clock [s].
            simulated: Whether ROS's clock is that of a simulation.
        """
        before, self._read = self._read, (simulated, stamp, steady)
        if before is None or before[0] != simulated:
            return self._passed
        wall, ros = steady - before[2], stamp - before[1]
        if simulated and 0.0 <= ros <= _LARGEST_LEAP + _LARGEST_SPEED * wall:
            self._passed += ros
        elif simulated:
            self.jumps += 1
        else:
            self._passed += wall
            self.jumps += abs(ros - wall) > 1.0
        return self._passed
