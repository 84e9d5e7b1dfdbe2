"""The exchange as messages of ctrl_rl_msgs, there and back, and how they are sent."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time as TimeMsg
from ctrl_rl_core.ros import float32_array, seconds, to_stamp
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, JointOptionStep, OptionGrant, OptionRequest
from option_coordinator.exchange import AgentState, Grant, GrantStatus, JointStep, Request, Status
from option_coordinator.options import Agent, slots

EXCHANGE = QoSProfile(depth=1000)
"""Of all topics, on both sides: with a depth of 10 most of 100 simultaneous messages are lost."""


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
    )


def request_of(message: OptionRequest) -> Request:
    """Return a request that was heard."""
    return Request(
        stamp=seconds(message.header.stamp),
        agent=message.agent,
        incarnation=message.incarnation,
        request_id=message.request_id,
        coordinator_epoch=message.coordinator_epoch,
        observation=np.frombuffer(message.observation, np.float32),
        legal=np.array(message.legal, bool),
        option_reward=message.option_reward,
        option_duration=message.option_duration,
        terminated=message.terminated,
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
    )


def status_of(message: AgentStatus) -> Status | None:
    """Return a heartbeat that was heard, None where its state is none."""
    if message.state not in set(AgentState):
        return None
    return Status(
        agent=message.agent,
        incarnation=message.incarnation,
        state=AgentState(message.state),
        coordinator_epoch=message.coordinator_epoch,
        request_id=message.request_id,
        grant_id=message.grant_id,
        option=message.option,
        elapsed=message.elapsed,
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
    )


def grant_of(message: OptionGrant) -> Grant | None:
    """Return a grant that was heard, None where its status is none."""
    if message.status not in set(GrantStatus):
        return None
    return Grant(
        stamp=seconds(message.header.stamp),
        agent=message.agent,
        incarnation=message.incarnation,
        request_id=message.request_id,
        coordinator_epoch=message.coordinator_epoch,
        grant_id=message.grant_id,
        status=GrantStatus(message.status),
        reason=message.reason,
        option=message.option,
        option_name=message.option_name,
        deadline=message.deadline,
    )


def word_message(epoch: int, now: float) -> CoordinatorStatus:
    """Return that a coordinator decides in an epoch, to be sent at a time [s]."""
    return CoordinatorStatus(header=_header(now), coordinator_epoch=epoch)


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
        self._own = slots(self._counts)

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
            duration=max(0, step.duration),
            discount=self._discount,
            time_step=self._time_step,
            terminated=step.terminated,
            truncated=step.truncated,
        )


def _header(stamp: float) -> Header:
    return Header(stamp=_time(stamp))


def _time(stamp: float) -> TimeMsg:
    return to_stamp(round(1e9 * stamp))
