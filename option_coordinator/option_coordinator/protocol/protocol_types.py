"""What robots and coordinator tell each other, as in ctrl_rl_msgs and without ROS. Times are seconds of one clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from option_coordinator.options.decision import NONE
from option_coordinator.options.options import Mask, Observation


class GrantStatus(IntEnum):
    """OptionGrant.status."""

    GRANTED = 0
    REFUSED = 1
    CANCELLED = 2


class AgentState(IntEnum):
    """AgentStatus.state."""

    IDLE = 0
    WAITING = 1
    RUNNING = 2
    FALLBACK = 3


@dataclass(frozen=True, eq=False)
class Request:
    """OptionRequest."""

    stamp: float
    agent: str
    incarnation: int
    request_id: int
    coordinator_epoch: int
    observation: Observation
    legal: Mask
    option_reward: float = 0.0
    option_duration: int = 0
    terminated: bool = False
    team: str = ""


@dataclass(frozen=True)
class Status:
    """AgentStatus."""

    agent: str
    incarnation: int
    state: AgentState
    coordinator_epoch: int = 0
    request_id: int = 0
    grant_id: int = 0
    option: int = 0
    elapsed: float = 0.0
    team: str = ""


@dataclass(frozen=True)
class Grant:
    """OptionGrant; its option is `NONE` where nothing is granted."""

    stamp: float
    agent: str
    incarnation: int
    request_id: int
    coordinator_epoch: int
    grant_id: int
    status: GrantStatus
    reason: str = ""
    option: int = NONE
    option_name: str = ""
    deadline: float = 0.0
    team: str = ""


class CoordinatorHeartbeat(NamedTuple):
    """CoordinatorStatus: a coordinator decides in an epoch."""

    epoch: int
    team: str = ""


@dataclass(frozen=True, eq=False)
class JointStep:
    """JointOptionStep; legal (N, K) as in `Decision`, observation of all, one after the other."""

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
    """Return whether two words may be of one team: an unnamed one, as of an old peer, is of any."""
    return one == other or not one or not other


@dataclass(frozen=True)
class Answers:
    """What a coordinator has to send now, in this order: grants, joint steps, and, where it is due, that it decides.

    Attributes:
        grants: to robots.
        steps: for the bag.
        heartbeat: that this one decides, for other coordinators and robots; None for nothing.
    """

    grants: list[Grant] = field(default_factory=list)
    steps: list[JointStep] = field(default_factory=list)
    heartbeat: CoordinatorHeartbeat | None = None
