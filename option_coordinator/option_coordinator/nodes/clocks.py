"""The clocks of a node: steady time, task time and ROS time, read together."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node

from option_coordinator.protocol.clock_reading import ClockReading, TaskTime

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of timers that go on while the ROS clock is set or paused."""


def steady_time() -> float:
    """Return the time since boot [s], which nobody sets and which goes on while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Clocks:
    """Reads the clocks of a node.

    Args:
        node: Node whose ROS clock is read.

    Attributes:
        task: Time in the robots' world, which also counts how often the ROS clock was set.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self.task = TaskTime()

    def __call__(self) -> ClockReading:
        """Return the current times."""
        stamp = 1e-9 * float(self._clock.now().nanoseconds)
        steady = steady_time()
        simulated = isinstance(self._clock, ROSClock) and self._clock.ros_time_is_active
        return ClockReading(steady, self.task(stamp, steady, simulated), stamp)
