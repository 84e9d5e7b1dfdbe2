"""Conversion between `protocol_types` and ctrl_rl_msgs messages, by field name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, Generic, TypeVar

import numpy as np
from ctrl_rl_core.ros import float32_array, seconds, to_stamp
from rclpy._rclpy_pybind11 import RCLError, RMWError
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, JointOptionStep, OptionGrant, OptionRequest
from option_coordinator.options.options import Agent, option_mask
from option_coordinator.protocol.protocol_types import (
    LARGEST_REQUEST,
    AgentState,
    AtMost,
    CoordinatorHeartbeat,
    Grant,
    GrantStatus,
    JointStep,
    MessageError,
    Request,
    Status,
    checks_of,
)

EXCHANGE = QoSProfile(depth=1000)
"""QoS of all topics, on both sides; with a depth of 10, most of 100 simultaneous messages would be lost."""
_LONGEST_STEP = 2**32 - 1
_REQUEST_SIZE = AtMost(LARGEST_REQUEST)
_Content = TypeVar("_Content")
_Convert = Callable[[Any], Any]


class Conversion(Generic[_Content]):
    """Converts between a type and its message by field name, and validates received messages.

    A field `stamp` [s] corresponds to the header's stamp.

    Args:
        content: Dataclass of the content.
        message: Class of the ROS message.
        write: Conversions of field values to message values, by name; other fields are passed on unchanged.
        read: Conversions of message values to field values, by name.
    """

    def __init__(
        self,
        content: type[_Content],
        message: type,
        write: Mapping[str, _Convert] | None = None,
        read: Mapping[str, _Convert] | None = None,
    ) -> None:
        self._content, self._message = content, message
        names = [field.name for field in fields(content)]  # type: ignore[arg-type]
        self._stamped = "stamp" in names
        checks = checks_of(content)
        own = [name for name in names if name != "stamp"]
        self._write = [(name, (write or {}).get(name)) for name in own]
        self._read = [(name, checks.get(name), (read or {}).get(name)) for name in own]

    def to_message(self, content: _Content, now: float = 0.0) -> Any:
        """Return the message, stamped with the content's own stamp, or with `now` [s] if it has none."""
        values = {}
        for name, convert in self._write:
            value = getattr(content, name)
            values[name] = value if convert is None else convert(value)
        return self._message(header=_header(getattr(content, "stamp", now)), **values)

    def from_message(self, message: Any) -> _Content:
        """Return the content of a message.

        Raises:
            MessageError: A value lies outside the range given in the message file.
        """
        values = {}
        for name, check, convert in self._read:
            value = getattr(message, name)
            if check is not None:
                check(value, name)
            values[name] = value if convert is None else convert(value)
        if self._stamped:
            values["stamp"] = seconds(message.header.stamp)
        return self._content(**values)


_REQUEST = Conversion(
    Request,
    OptionRequest,
    {"observation": float32_array, "legal": np.ndarray.tolist, "option_reward": float},
    {"observation": lambda numbers: np.frombuffer(numbers, np.float32), "legal": lambda flags: np.array(flags, bool)},
)
_STATUS = Conversion(Status, AgentStatus, {"state": int}, {"state": AgentState})
_GRANT = Conversion(
    Grant, OptionGrant, {"status": int, "option": lambda option: max(0, option)}, {"status": GrantStatus}
)
_HEARTBEAT = Conversion(CoordinatorHeartbeat, CoordinatorStatus)

request_message: Callable[[Request], OptionRequest] = _REQUEST.to_message
request_of: Callable[[OptionRequest], Request] = _REQUEST.from_message
status_message: Callable[[Status, float], AgentStatus] = _STATUS.to_message
status_of: Callable[[AgentStatus], Status] = _STATUS.from_message
grant_message: Callable[[Grant], OptionGrant] = _GRANT.to_message
grant_of: Callable[[OptionGrant], Grant] = _GRANT.from_message
heartbeat_message: Callable[[CoordinatorHeartbeat, float], CoordinatorStatus] = _HEARTBEAT.to_message
heartbeat_of: Callable[[CoordinatorStatus], CoordinatorHeartbeat] = _HEARTBEAT.from_message


def request_in(content: bytes) -> Request:
    """Deserialise a request; one that is too large is rejected first.

    Raises:
        MessageError: The message is not an OptionRequest, or a value lies outside its range.
    """
    _REQUEST_SIZE(content, "request")
    try:
        return request_of(deserialize_message(content, OptionRequest))
    except (RCLError, RMWError, UnicodeDecodeError) as error:
        raise MessageError("request of another layout") from error


class StepMessages:
    """Converts the joint steps of one team to messages.

    Args:
        agents: Robots, in the policy's order.
        discount: Discount factor gamma of a low-level step.
        time_step: Duration of a low-level step [s].
    """

    def __init__(self, agents: tuple[Agent, ...], discount: float, time_step: float) -> None:
        self._discount, self._time_step = discount, time_step
        self._names = [agent.name for agent in agents]
        self._counts = [len(agent.options) for agent in agents]
        self._sizes = [agent.observation_size for agent in agents]
        self._own = option_mask(self._counts)

    def __call__(self, step: JointStep) -> JointOptionStep:
        """Convert one joint step to a message."""
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
    return Header(stamp=to_stamp(round(1e9 * stamp)))
