"""The exchange as messages of ctrl_rl_msgs, there and back, and how they are sent."""

from __future__ import annotations

import math

import numpy as np
from builtin_interfaces.msg import Time as TimeMsg
from ctrl_rl_core.ros.node import float32_array, seconds, to_stamp
from rclpy._rclpy_pybind11 import RCLError, RMWError
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, JointOptionStep, OptionGrant, OptionRequest
from option_coordinator.options.options import Agent, option_mask
from option_coordinator.protocol import message_checks
from option_coordinator.protocol.message_checks import LARGEST_LIFE, LARGEST_REWARD, LONGEST, MessageError
from option_coordinator.protocol.protocol_types import (
    AgentState,
    CoordinatorHeartbeat,
    Grant,
    GrantStatus,
    JointStep,
    Request,
    Status,
)

EXCHANGE = QoSProfile(depth=1000)
"""Of all topics, on both sides: with a depth of 10 most of 100 simultaneous messages are lost."""
_STATES = {int(state): state for state in AgentState}
_STATUSES = {int(status): status for status in GrantStatus}
_LONGEST_STEP = 2**32 - 1


def request_message(request: Request) -> OptionRequest:
    """Return a request to be sent."""
    return OptionRequest(
        header=_header(request.stamp),
        agent=request.agent,
        incarnation=request.incarnation,
        request_id=request.request_id,
        coordinator_epoch=request.coordinator_epoch,
        observation=float32_array(request.observation),
        legal=request.legal.tolist(),
        option_reward=float(request.option_reward),
        option_duration=request.option_duration,
        terminated=request.terminated,
        team=request.team,
    )


def request_in(content: bytes) -> Request:
    """Return a request that was heard, from the bytes of its message: too many of them are not looked at.

    Raises:
        MessageError: it is none, or holds what no robot may say.
    """
    message_checks.sized(content, "request", message_checks.LARGEST_REQUEST)
    try:
        return request_of(deserialize_message(content, OptionRequest))
    except (RCLError, RMWError, UnicodeDecodeError) as error:
        raise MessageError("request of another layout") from error


def request_of(message: OptionRequest) -> Request:
    """Return a request that was heard.

    A reward that is not finite stays so: who sent it is told, see `refusal`.

    Raises:
        MessageError: it holds what no robot may say.
    """
    message_checks.sized(message.observation, "observation", message_checks.MOST_NUMBERS)
    message_checks.sized(message.legal, "legal options", message_checks.MOST_OPTIONS)
    reward = message.option_reward
    if math.isfinite(reward):
        message_checks.real(reward, "option_reward", -LARGEST_REWARD, LARGEST_REWARD)
    return Request(
        stamp=seconds(message.header.stamp),
        agent=message_checks.name(message.agent, "agent"),
        incarnation=message_checks.number(message.incarnation, "incarnation", 1, LARGEST_LIFE),
        request_id=message_checks.number(message.request_id, "request_id", 1),
        coordinator_epoch=message_checks.number(message.coordinator_epoch, "coordinator_epoch"),
        observation=np.frombuffer(message.observation, np.float32),
        legal=np.array(message.legal, bool),
        option_reward=reward,
        option_duration=message.option_duration,
        terminated=message.terminated,
        team=message_checks.name(message.team, "team"),
    )


def status_message(status: Status, now: float) -> AgentStatus:
    """Return a heartbeat to be sent at a time [s]."""
    return AgentStatus(
        header=_header(now),
        agent=status.agent,
        incarnation=status.incarnation,
        state=int(status.state),
        coordinator_epoch=status.coordinator_epoch,
        request_id=status.request_id,
        grant_id=status.grant_id,
        option=status.option,
        elapsed=status.elapsed,
        team=status.team,
    )


def status_of(message: AgentStatus) -> Status:
    """Return a heartbeat that was heard.

    Raises:
        MessageError: it holds what no robot may say.
    """
    state = _STATES.get(message.state)
    if state is None:
        raise MessageError("state out of range")
    return Status(
        agent=message_checks.name(message.agent, "agent"),
        incarnation=message_checks.number(message.incarnation, "incarnation", 1, LARGEST_LIFE),
        state=state,
        coordinator_epoch=message_checks.number(message.coordinator_epoch, "coordinator_epoch"),
        request_id=message_checks.number(message.request_id, "request_id"),
        grant_id=message_checks.number(message.grant_id, "grant_id"),
        option=message.option,
        elapsed=message_checks.real(message.elapsed, "elapsed", 0.0, LONGEST),
        team=message_checks.name(message.team, "team"),
    )


def grant_message(grant: Grant) -> OptionGrant:
    """Return a grant to be sent."""
    return OptionGrant(
        header=_header(grant.stamp),
        agent=grant.agent,
        incarnation=grant.incarnation,
        request_id=grant.request_id,
        coordinator_epoch=grant.coordinator_epoch,
        grant_id=grant.grant_id,
        status=int(grant.status),
        reason=grant.reason,
        option=max(0, grant.option),
        option_name=grant.option_name,
        deadline=grant.deadline,
        team=grant.team,
    )


def grant_of(message: OptionGrant) -> Grant:
    """Return a grant that was heard.

    Raises:
        MessageError: it holds what no coordinator may say.
    """
    status = _STATUSES.get(message.status)
    if status is None:
        raise MessageError("status out of range")
    return Grant(
        stamp=seconds(message.header.stamp),
        agent=message_checks.name(message.agent, "agent"),
        incarnation=message_checks.number(message.incarnation, "incarnation", 1, LARGEST_LIFE),
        request_id=message_checks.number(message.request_id, "request_id", 1),
        coordinator_epoch=message_checks.number(message.coordinator_epoch, "coordinator_epoch"),
        grant_id=message_checks.number(message.grant_id, "grant_id"),
        status=status,
        reason=message.reason,
        option=message.option,
        option_name=message.option_name,
        deadline=message_checks.real(message.deadline, "deadline", 0.0, LONGEST),
        team=message_checks.name(message.team, "team"),
    )


def heartbeat_message(heartbeat: CoordinatorHeartbeat, now: float) -> CoordinatorStatus:
    """Return that a coordinator decides, to be sent at a time [s]."""
    return CoordinatorStatus(header=_header(now), coordinator_epoch=heartbeat.epoch, team=heartbeat.team)


def heartbeat_of(message: CoordinatorStatus) -> CoordinatorHeartbeat:
    """Return that a coordinator was heard to decide.

    Raises:
        MessageError: it holds what no coordinator may say.
    """
    epoch = message_checks.number(message.coordinator_epoch, "coordinator_epoch", 1)
    return CoordinatorHeartbeat(epoch, message_checks.name(message.team, "team"))


class StepMessages:
    """Writes the joint steps of one team.

    Args:
        agents: the robots, in the policy's order.
        discount: gamma of a low-level step.
        time_step: how long one lasts [s].
    """

    def __init__(self, agents: tuple[Agent, ...], discount: float, time_step: float) -> None:
        self._discount, self._time_step = discount, time_step
        self._names = [agent.name for agent in agents]
        self._counts = [len(agent.options) for agent in agents]
        self._sizes = [agent.observation_size for agent in agents]
        self._own = option_mask(self._counts)

    def __call__(self, step: JointStep) -> JointOptionStep:
        """Return one to be sent."""
        return JointOptionStep(
            header=_header(step.stamp),
            coordinator_epoch=step.coordinator_epoch,
            step=step.step,
            policy_digest=step.policy_digest,
            agents=self._names,
            running=step.running.tolist(),
            absent=step.absent.tolist(),
            options=step.options.tolist(),
            legal=step.legal[self._own].tolist(),
            option_counts=self._counts,
            observations=float32_array(step.observation),
            observation_sizes=self._sizes,
            log_probability=float(step.log_probability),
            reward=float(step.reward),
            duration=min(max(0, step.duration), _LONGEST_STEP),
            discount=self._discount,
            time_step=self._time_step,
            terminated=step.terminated,
            truncated=step.truncated,
        )


def _header(stamp: float) -> Header:
    return Header(stamp=_time(stamp))


def _time(stamp: float) -> TimeMsg:
    return to_stamp(round(1e9 * stamp))
