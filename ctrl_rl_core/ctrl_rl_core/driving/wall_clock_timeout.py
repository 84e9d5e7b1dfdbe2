"""Time-outs of inputs in wall time, for nodes whose own clock is simulated and may stand still."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType

from ctrl_rl_core.ros.node import SuiteNode
from ctrl_rl_core.ros.parameters import Parameter

WALL_TIMEOUT = Parameter(
    "wall_timeout",
    5.0,
    "Age of an input in wall time that stops the robot even while the simulated clock stands still [s].",
    0.1,
    3600.0,
)


class WallClockTimeout:
    """Watches the ages of inputs on a steady clock.

    It waits longer than the node's own time-out, since a simulation may run slower than real time.
    """

    def __init__(self, node: SuiteNode, look: Callable[[], None]) -> None:
        """Start the watch.

        Args:
            node: Node with the parameter WALL_TIMEOUT.
            look: Callback that runs four times in each time-out.
        """
        self._limit: float = node.settings[WALL_TIMEOUT.name]
        self._heard: dict[str, float] = {}
        node.create_timer(0.25 * self._limit, look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def note_input(self, what: str) -> None:
        """Note that an input has just come."""
        self._heard[what] = time.monotonic()

    def overdue(self, what: str) -> bool:
        """Return whether an input that once came stays away for too long."""
        at = self._heard.get(what)
        return at is not None and time.monotonic() - at > self._limit
