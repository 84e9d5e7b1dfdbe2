"""The time of an event on three clocks. No ROS.

Silence is measured on a steady clock, which is never adjusted. Option durations are measured in task time, because a
simulation may be paused or faster than real time. Messages are stamped by the ROS clock, which may be adjusted at any
time.
"""

from __future__ import annotations

from typing import NamedTuple

_LARGEST_LEAP = 10.0
_LARGEST_SPEED = 100.0


class ClockReading(NamedTuple):
    """The time of an event on three clocks [s].

    Attributes:
        steady: Steady clock, for leases, time-outs and repetitions.
        task: Time elapsed in the robots' world, measured by `TaskTime`, for option durations.
        stamp: ROS clock, for the stamps of messages.
    """

    steady: float
    task: float
    stamp: float


class TaskTime:
    """Time in the robots' world [s]: starts at 0, never decreases, and ignores clock adjustments.

    Without simulation, this is steady time. In a simulation, a jump back, or a jump ahead of more than 10 s and more
    than 100 times real time, counts as a clock adjustment during which no time passes.

    Attributes:
        jumps: Number of clock adjustments.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._passed = 0.0
        self._read: tuple[bool, float, float] | None = None

    def __call__(self, stamp: float, steady: float, simulated: bool) -> float:
        """Return the elapsed task time.

        Args:
            stamp: ROS clock [s].
            steady: Steady clock [s].
            simulated: Whether the ROS clock is simulated.
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
