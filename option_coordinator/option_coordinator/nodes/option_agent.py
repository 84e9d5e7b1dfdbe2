"""Client of an option coordinator for use in any node: four topics and a timer around `OptionClient`.

    class Robot(SuiteNode):
        def __init__(self):
            ...
            self.agent = OptionAgent(self, "robot_1", ("wait", "shelf", "desk"), executor=self)
            self.agent.start()

`executor` has the three methods of `OptionExecutor`: `observe`, `begin` and `leave`; with a fourth, `resume`, its work
outlives its process (see `Resumes`). The node calls `agent.ended(...)` when an option has terminated. Repetitions,
heartbeats, acknowledgements, cancellation and the safe option are handled here. The node's log has the reason of each
refusal.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, OptionGrant, OptionRequest
from option_coordinator.nodes.messages import EXCHANGE, grant_of, heartbeat_of, request_message, status_message
from option_coordinator.protocol.clock_reading import ClockReading, TaskTime
from option_coordinator.protocol.option_client import ClientTimeouts, OptionClient
from option_coordinator.protocol.option_executor import OptionExecutor, OptionResult
from option_coordinator.protocol.protocol_types import AgentState, MessageError, Request, TeamId
from option_coordinator.protocol.work_memory import WorkMemory

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock for timers that must run while the ROS clock is adjusted or paused."""
_SAID_EVERY_S = 10.0


def steady_time() -> float:
    """Return the time since boot [s], which is never adjusted and includes time in sleep mode."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Clocks:
    """Reads the clocks of a node.

    Args:
        node: Node whose ROS clock is read.

    Attributes:
        task: Time in the robots' world; also counts the jumps of the ROS clock.
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


class OptionAgent:
    """Requests options for a robot, and has its executor run them.

    Args:
        node: Node whose topics, timer and clock are used.
        name: Name of the robot in its team.
        options: Names of the robot's options.
        executor: Executor of the options, often the node itself.
        safe_option: Index of the option to run while no grant arrives.
        timeouts: Periods and waiting times; the default ones if omitted.
        namespace: Namespace of the coordinator's topics; the node's own if empty.
        team: Name of the team, and the digest of its file if known; may be empty if the namespace has only one team.
        memory: SQLite file that keeps the robot's work, see `OptionClient`; none by default.

    Raises:
        OptionError: The file cannot be used.

    Attributes:
        client: Client that talks to the coordinator.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        options: Sequence[str],
        executor: OptionExecutor,
        safe_option: int = 0,
        timeouts: ClientTimeouts | None = None,
        namespace: str = "",
        team: TeamId | str = "",
        memory: Path | None = None,
    ) -> None:
        timeouts = timeouts or ClientTimeouts()
        self._now, self._node = Clocks(node), node
        self._said: tuple[str, float] = ("", 0.0)
        # Incarnations of a robot are identified and ordered by their start on the wall clock, which persists.
        kept = WorkMemory(memory, team if isinstance(team, str) else team.name)
        self.client = OptionClient(name, options, executor, time.time_ns(), safe_option, timeouts, team, kept)
        prefix = f"{namespace.rstrip('/')}/" if namespace else ""
        self._requests = node.create_publisher(OptionRequest, f"{prefix}option_requests", EXCHANGE)
        self._statuses = node.create_publisher(AgentStatus, f"{prefix}agent_status", EXCHANGE)
        hears = partial(self._take, grant_of, self.client.on_grant)
        node.create_subscription(OptionGrant, f"{prefix}option_grants", hears, EXCHANGE)
        hears = partial(self._take, heartbeat_of, self.client.on_coordinator_heartbeat)
        node.create_subscription(CoordinatorStatus, f"{prefix}coordinator_status", hears, EXCHANGE)
        node.create_timer(0.25 * min(timeouts.heartbeat, timeouts.repeat), self._tick, clock=STEADY)

    @property
    def option(self) -> int | None:
        """The granted option that is running, or None."""
        running = self.client.state is AgentState.RUNNING and self.client.grant is not None
        return self.client.grant.option if running and self.client.grant is not None else None

    def start(self) -> None:
        """Request the first option."""
        self.client.ask(self._now())
        self._send_due()

    def ended(self, reward: float = 0.0, steps: int = 0, terminated: bool = False) -> None:
        """Report that the option has terminated, and request the next one.

        Args:
            reward: Discounted reward of the option, as in `OptionResult`.
            steps: Number of low-level steps of the option.
            terminated: Whether the task is over for this robot, which then makes no further requests.
        """
        self.client.ended(self._now(), OptionResult(reward, steps), terminated)
        self._send_due()

    def _take(self, read: Callable[[Any], Any], take: Callable[[Any, ClockReading], None], message: Any) -> None:
        try:
            take(read(message), self._now())
        except MessageError as error:
            self.client.counts[f"not taken: {error.kind}"] += 1
        else:
            self._send_due()

    def _tick(self) -> None:
        self.client.tick(self._now())
        self._send_due()

    def _send_due(self) -> None:
        now = self._now()
        self._report_problem(now.steady)
        for message in self.client.due_messages(now):
            if isinstance(message, Request):
                self._requests.publish(request_message(message))
            else:
                self._statuses.publish(status_message(message, now.stamp))

    def _report_problem(self, now: float) -> None:
        """Log why the robot has no option: at once, and again from time to time; numbers alone are no news."""
        problem = self.client.problem
        if not problem:
            return
        kind, (last, at) = re.sub(r"[\d.]+", "#", problem), self._said
        if kind != last or now - at > _SAID_EVERY_S:
            self._said = kind, now
            self._node.get_logger().warning(f"{self.client.name}: {problem}")
