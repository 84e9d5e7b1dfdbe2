"""The messages between robots and coordinator, field by field as in ctrl_rl_msgs, without ROS. Stamps are in seconds.

An annotation holds a field's range, see `message_checks`. The message files say what each field means.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from option_coordinator.options.decision import NONE
from option_coordinator.options.options import Mask, Observation
from option_coordinator.protocol.message_checks import (
    MOST_NUMBERS,
    MOST_OPTIONS,
    AtMost,
    Count,
    CountFrom1,
    Duration,
    Life,
    Name,
    OptionReward,
    constants,
)


class GrantStatus(IntEnum):
    """Constants of OptionGrant.status."""

    GRANTED = 0
    REFUSED = 1
    CANCELLED = 2


class AgentState(IntEnum):
    """Constants of AgentStatus.state."""

    IDLE = 0
    WAITING = 1
    RUNNING = 2
    FALLBACK = 3


@dataclass(frozen=True, eq=False)
class Request:
    """An OptionRequest: a robot asks for its next option."""

    stamp: float
    agent: Name
    incarnation: Life
    request_id: CountFrom1
    coordinator_epoch: Count
    observation: Annotated[Observation, AtMost(MOST_NUMBERS)]
    legal: Annotated[Mask, AtMost(MOST_OPTIONS, "legal options")]
    option_reward: OptionReward = 0.0
    option_duration: int = 0
    terminated: bool = False
    team: Name = ""


@dataclass(frozen=True)
class Status:
    """An AgentStatus: a robot's heartbeat."""

    agent: Name
    incarnation: Life
    state: Annotated[AgentState, constants(AgentState)]
    coordinator_epoch: Count = 0
    request_id: Count = 0
    grant_id: Count = 0
    option: int = 0
    elapsed: Duration = 0.0
    team: Name = ""


@dataclass(frozen=True)
class Grant:
    """An OptionGrant: the answer to a request; its option is `NONE` where nothing is granted."""

    stamp: float
    agent: Name
    incarnation: Life
    request_id: CountFrom1
    coordinator_epoch: Count
    grant_id: Count
    status: Annotated[GrantStatus, constants(GrantStatus)]
    reason: str = ""
    option: int = NONE
    option_name: str = ""
    deadline: Duration = 0.0
    team: Name = ""


@dataclass(frozen=True)
class CoordinatorHeartbeat:
    """A CoordinatorStatus: a coordinator decides in an epoch."""

    coordinator_epoch: CountFrom1
    team: Name = ""


@dataclass(frozen=True, eq=False)
class JointStep:
    """A JointOptionStep: legal (N, K) as in `Decision`, observations of all robots one after the other."""

    stamp: float
    coordinator_epoch: int
    step: int
    policy_digest: str
    running: Mask
    absent: Mask
    options: NDArray[np.int64]
    legal: Mask
    observation: Observation
    log_probability: float
    reward: float
    duration: int
    terminated: bool
    truncated: bool = False


def same_team(one: str, other: str) -> bool:
    """Return whether two messages may belong to one team; a message of an old peer, without a name, fits any."""
    return one == other or not one or not other


@dataclass(frozen=True)
class Answers:
    """The messages that a coordinator sends now, in this order.

    Attributes:
        grants: Answers to robots.
        steps: Joint steps, for the bag.
        heartbeat: Heartbeat for robots and other coordinators; None where none is due.
    """

    grants: list[Grant] = field(default_factory=list)
    steps: list[JointStep] = field(default_factory=list)
    heartbeat: CoordinatorHeartbeat | None = None
