"""A team under the real coordinator: robots ask in turn, each once the one before has its option: draws repeat."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from case import BehaviourError, Case
from commands import NODES
from digests import Parts, digest, message_text
from messages import Bag

_TEAM, _ROBOTS = "delivery_team", ("robot_1", "robot_2", "robot_3")
_REQUESTS = 60
_ARRIVAL = 1_000_000_000
"""Incarnation of each robot."""
_OF_A_GRANT = ("agent", "request_id", "grant_id", "status", "reason", "option", "option_name", "deadline", "team")
_OF_THE_DAY = ("header", "coordinator_epoch", "policy_digest")
"""Fields of a decision that are not the same twice."""


def coordinate(folder: Path) -> dict[str, Parts]:
    """Let the robots of a team ask in turn; return the parts of grants and decisions, and leave a bag of these."""
    from rclpy.qos import QoSProfile
    from rig import Rig

    from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, JointOptionStep, OptionGrant, OptionRequest

    topics = {
        "option_grants": OptionGrant,
        "joint_option_step": JointOptionStep,
        "coordinator_status": CoordinatorStatus,
    }
    random, granted = np.random.default_rng(0), []

    def stamped(kind: Any, **fields: Any) -> Any:
        message = kind(**fields, incarnation=_ARRIVAL, team=_TEAM)
        message.header.stamp = rig.node.get_clock().now().to_msg()
        return message

    with Rig(folder, {"coordinator": NODES["coordinator"]}, topics, {}) as rig:
        grants, decisions, words = rig.heard.values()
        requests = rig.publisher(OptionRequest, "option_requests", 1, QoSProfile(depth=1000))
        statuses = rig.publisher(AgentStatus, "agent_status", 1, QoSProfile(depth=1000))

        def present() -> None:
            for name in _ROBOTS:
                statuses.publish(stamped(AgentStatus, agent=name, state=AgentStatus.IDLE))

        rig.until(lambda: bool(words), "the coordinator's heartbeat", present)
        epoch = words[-1].coordinator_epoch
        for number in range(_REQUESTS):
            who = {"agent": _ROBOTS[number % len(_ROBOTS)], "request_id": 1 + number // len(_ROBOTS)}
            seen = [*random.uniform(-1.4, 1.4, 2), *random.integers(0, 2, 2)]
            ended = who["request_id"] > 1
            earned = {"option_reward": 0.1 * number * ended, "option_duration": 7 * ended}
            requests.publish(stamped(OptionRequest, **who, coordinator_epoch=epoch, observation=seen, **earned))
            granted.append(_answer(rig, grants, **who))
            accepted = {"grant_id": granted[-1].grant_id, "option": granted[-1].option, "coordinator_epoch": epoch}
            statuses.publish(stamped(AgentStatus, **who, state=AgentStatus.RUNNING, **accepted))
            rig.until(lambda count=number + 1: len(decisions) >= count, "a decision")
    _write(folder / "team", decisions)
    kept = [name for name in JointOptionStep.get_fields_and_field_types() if name not in _OF_THE_DAY]
    return {"": {"grants": _digest(granted, _OF_A_GRANT), "decisions": _digest(decisions, kept)}}


def _write(folder: Path, decisions: list[Any]) -> None:
    """Write a bag of decisions whose epoch and times are always the same."""
    from rclpy.serialization import serialize_message

    with Bag(folder, {"/joint_option_step": "ctrl_rl_msgs/msg/JointOptionStep"}) as bag:
        for number, decision in enumerate(decisions):
            decision.coordinator_epoch, decision.header.stamp.sec, decision.header.stamp.nanosec = 1, 1000 + number, 0
            bag.put_bytes("/joint_option_step", (1000 + number) * 10**9, serialize_message(decision))


def _answer(rig: Any, grants: list[Any], agent: str, request_id: int) -> Any:
    """Return the first answer to a request.

    Raises:
        BehaviourError: It is refused.
    """

    def found() -> Any:
        return next((each for each in grants if (each.agent, each.request_id) == (agent, request_id)), None)

    rig.until(lambda: found() is not None, f"a grant for {agent}")
    if found().status != 0:
        raise BehaviourError(f"request {request_id} of {agent} is refused: {found().reason}")
    return found()


def _digest(messages: list[Any], names: Sequence[str]) -> str:
    """Return a digest of some fields of messages."""
    return digest("\n".join(",".join(message_text(getattr(each, name)) for name in names) for each in messages))


TEAM = (Case("team_coordinated", work=coordinate),)
