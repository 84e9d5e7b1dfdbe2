"""The client of an option coordinator as a part of any node: four topics and a timer around `OptionClient`.

    class Robot(SuiteNode):
        def __init__(self):
            ...
            self.agent = OptionAgent(self, "robot_1", ("wait", "shelf", "desk"), executor=self)
            self.agent.start()

`executor` has the three methods of `OptionExecutor`: `observe`, `begin` and `leave`. The node calls `agent.ended(...)`
when an option has ended by itself. Repetitions, heartbeats, acknowledgements, cancellation and the safe option are
handled here.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from rclpy.node import Node

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, OptionGrant, OptionRequest
from option_coordinator.nodes.clocks import STEADY, Clocks
from option_coordinator.nodes.messages import EXCHANGE, grant_of, heartbeat_of, request_message, status_message
from option_coordinator.protocol.message_checks import MessageError
from option_coordinator.protocol.option_client import ClientTimeouts, OptionClient, OptionExecutor, OptionResult
from option_coordinator.protocol.protocol_types import AgentState, Request


class OptionAgent:
    """A robot that is granted options.

    Args:
        node: whose topics, timer and clock are used.
        name: of the robot, as its team knows it.
        options: names of its options.
        executes: carries them out.
        safe_option: index of the one that is carried out without a grant.
        patience: how long it waits for what.
        namespace: of the coordinator's topics.
        team: Name of the team; empty where there is one only in the coordinator's namespace.

    Attributes:
        side: what it knows.
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
        team: str = "",
    ) -> None:
        timeouts = timeouts or ClientTimeouts()
        self._now = Clocks(node)
        # Lives of a robot are told apart, and ordered, by when they began: of the wall's clock, which goes on.
        self.client = OptionClient(name, len(options), executor, time.time_ns(), safe_option, timeouts, team)
        prefix = f"{namespace.rstrip('/')}/" if namespace else ""
        self._requests = node.create_publisher(OptionRequest, f"{prefix}option_requests", EXCHANGE)
        self._statuses = node.create_publisher(AgentStatus, f"{prefix}agent_status", EXCHANGE)
        node.create_subscription(OptionGrant, f"{prefix}option_grants", self._on_grant, EXCHANGE)
        node.create_subscription(
            CoordinatorStatus, f"{prefix}coordinator_status", self._on_coordinator_heartbeat, EXCHANGE
        )
        node.create_timer(0.25 * min(timeouts.heartbeat, timeouts.repeat), self._tick, clock=STEADY)

    @property
    def option(self) -> int | None:
        """The option that was granted and runs, None for none."""
        running = self.client.state is AgentState.RUNNING and self.client.grant is not None
        return self.client.grant.option if running and self.client.grant is not None else None

    def start(self) -> None:
        """Ask for the first option."""
        self.client.ask(self._now())
        self._send_due()

    def ended(self, reward: float = 0.0, steps: int = 0, terminated: bool = False) -> None:
        """Say that the option has ended by itself, and ask for the next one.

        Args:
            reward: what the option brought, see `OptionResult`.
            steps: low-level steps that it took.
            terminated: the task is over for this robot: nothing more is asked for.
        """
        self.client.ended(self._now(), OptionResult(reward, steps), terminated)
        self._send_due()

    def _on_grant(self, message: OptionGrant) -> None:
        try:
            grant = grant_of(message)
        except MessageError as error:
            self.client.counts[f"not taken: {error.kind}"] += 1
            return
        self.client.on_grant(grant, self._now())
        self._send_due()

    def _on_coordinator_heartbeat(self, message: CoordinatorStatus) -> None:
        try:
            self.client.on_coordinator_heartbeat(heartbeat_of(message), self._now())
        except MessageError as error:
            self.client.counts[f"not taken: {error.kind}"] += 1

    def _tick(self) -> None:
        self.client.tick(self._now())
        self._send_due()

    def _send_due(self) -> None:
        now = self._now()
        for message in self.client.due_messages(now):
            if isinstance(message, Request):
                self._requests.publish(request_message(message))
            else:
                self._statuses.publish(status_message(message, now.stamp))
