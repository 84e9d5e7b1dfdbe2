"""A node's three clocks, read at once."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node

from option_coordinator.protocol.clock_reading import ClockReading, TaskTime

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""For timers that go on whatever happens to ROS's clock."""


def steady_time() -> float:
    """Return the time of a clock that nobody sets, and that goes on while the machine sleeps [s]."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Clocks:
    """Reads the clocks of a node.

    Args:
        node: whose ROS clock is read.

    Attributes:
        task: Time in the robots' world; counts how often ROS's clock was set.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self.task = TaskTime()

    def __call__(self) -> ClockReading:
        """Return this moment."""
        stamp = 1e-9 * float(self._clock.now().nanoseconds)
        steady = steady_time()
        simulated = isinstance(self._clock, ROSClock) and self._clock.ros_time_is_active
        return ClockReading(steady, self.task(stamp, steady, simulated), stamp)
