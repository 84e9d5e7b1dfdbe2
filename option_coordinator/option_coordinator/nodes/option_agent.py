"""The robot's side as a part of any node: four topics and a timer around `RobotSide`.

    class Robot(SuiteNode):
        def __init__(self):
            ...
            self.agent = OptionAgent(self, "robot_1", ("wait", "shelf", "desk"), executes=self)
            self.agent.start()

`executes` has three methods, `observe`, `begin` and `leave` (see `Executes`). Who carries an option out to its end says
`agent.ended(...)`. All else, repetitions, heartbeats, acknowledgements, cancellation, the safe option, is done here.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from rclpy.node import Node

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, OptionGrant, OptionRequest
from option_coordinator.nodes.clocks import STEADY, Clocks
from option_coordinator.nodes.messages import EXCHANGE, grant_of, request_message, status_message, word_of
from option_coordinator.protocol.message_checks import MessageError
from option_coordinator.protocol.option_client import Earned, Executes, Patience, RobotSide
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
        executes: Executes,
        safe_option: int = 0,
        patience: Patience | None = None,
        namespace: str = "",
        team: str = "",
    ) -> None:
        patience = patience or Patience()
        self._now = Clocks(node)
        # Lives of a robot are told apart, and ordered, by when they began: of the wall's clock, which goes on.
        self.side = RobotSide(name, len(options), executes, time.time_ns(), safe_option, patience, team)
        prefix = f"{namespace.rstrip('/')}/" if namespace else ""
        self._requests = node.create_publisher(OptionRequest, f"{prefix}option_requests", EXCHANGE)
        self._statuses = node.create_publisher(AgentStatus, f"{prefix}agent_status", EXCHANGE)
        node.create_subscription(OptionGrant, f"{prefix}option_grants", self._on_grant, EXCHANGE)
        node.create_subscription(CoordinatorStatus, f"{prefix}coordinator_status", self._on_word, EXCHANGE)
        node.create_timer(0.25 * min(patience.heartbeat, patience.repeat), self._tick, clock=STEADY)

    @property
    def option(self) -> int | None:
        """The option that was granted and runs, None for none."""
        running = self.side.state is AgentState.RUNNING and self.side.grant is not None
        return self.side.grant.option if running and self.side.grant is not None else None

    def start(self) -> None:
        """Ask for the first option."""
        self.side.ask(self._now())
        self._say()

    def ended(self, reward: float = 0.0, steps: int = 0, terminated: bool = False) -> None:
        """Say that the option has ended by itself, and ask for the next one.

        Args:
            reward: what the option brought, see `Earned`.
            steps: low-level steps that it took.
            terminated: the task is over for this robot: nothing more is asked for.
        """
        self.side.ended(self._now(), Earned(reward, steps), terminated)
        self._say()

    def _on_grant(self, message: OptionGrant) -> None:
        try:
            grant = grant_of(message)
        except MessageError as error:
            self.side.counts[f"not taken: {error.kind}"] += 1
            return
        self.side.on_grant(grant, self._now())
        self._say()

    def _on_word(self, message: CoordinatorStatus) -> None:
        try:
            self.side.on_word(word_of(message), self._now())
        except MessageError as error:
            self.side.counts[f"not taken: {error.kind}"] += 1

    def _tick(self) -> None:
        self.side.tick(self._now())
        self._say()

    def _say(self) -> None:
        now = self._now()
        for word in self.side.words(now):
            if isinstance(word, Request):
                self._requests.publish(request_message(word))
            else:
                self._statuses.publish(status_message(word, now.stamp))
