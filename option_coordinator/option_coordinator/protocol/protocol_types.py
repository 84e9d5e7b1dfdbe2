"""Messages between robots and coordinator, with the fields of ctrl_rl_msgs but without ROS. Stamps are in seconds.

`checks_of` returns the checks of a type by field; each message is checked once, on conversion. Team-dependent checks
(sizes, names, options, epochs, order) are done by the coordinator and the clients.

Annotations give the range of each field; the message files document its meaning.
"""

from __future__ import annotations

import math
from collections.abc import Sized
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE, Mask, Observation

LARGEST_COUNT = (1 << 62) - 1
"""Maximum epoch, request or grant number, never reached by counting from 0."""
LARGEST_LIFE = (1 << 63) - 1
LARGEST_REWARD = 1e9
LONGEST = 1e7
"""Maximum duration of an option [s]."""
LONGEST_NAME = 255
LONGEST_DIGEST = 64
MOST_NUMBERS = 65536
MOST_OPTIONS = 10000
LARGEST_REQUEST = 4 * MOST_NUMBERS + MOST_OPTIONS + 3 * LONGEST_NAME + 1024
"""Maximum size of a serialised OptionRequest [bytes]."""


class MessageError(OptionError):
    """A message has a value outside the range given in its message file.

    Attributes:
        kind: Short reason without message content, used as a counter key.
    """

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.kind = kind


class Between(NamedTuple):
    """Check for a number in a closed interval; NaN is never inside.

    Attributes:
        minimum: Lower end of the interval.
        maximum: Upper end of the interval.
        or_not_finite: Whether to accept non-finite numbers, which the coordinator then refuses with a reason.
    """

    minimum: float
    maximum: float
    or_not_finite: bool = False

    def __call__(self, value: float, field: str, /) -> None:
        """Raise MessageError, naming the field, if the number is out of range."""
        if not self.minimum <= value <= self.maximum and not (self.or_not_finite and not math.isfinite(value)):
            raise MessageError(f"{field} out of range")


class AtMost(NamedTuple):
    """Check for a text or array of limited length; errors use `label`, or the field's name."""

    length: int
    label: str = ""

    def __call__(self, value: Sized, field: str, /) -> None:
        """Raise MessageError if it is too long."""
        if len(value) > self.length:
            raise MessageError(f"{self.label or field} too long")


def constants(kind: type[IntEnum]) -> Between:
    """Return a check that a number is a constant of an enumeration without gaps."""
    return Between(min(kind), max(kind))


Name = Annotated[str, AtMost(LONGEST_NAME)]
Work = Annotated[str, AtMost(LONGEST_NAME)]
Digest = Annotated[str, AtMost(LONGEST_DIGEST)]
Life = Annotated[int, Between(1, LARGEST_LIFE)]
Count = Annotated[int, Between(0, LARGEST_COUNT)]
CountFrom1 = Annotated[int, Between(1, LARGEST_COUNT)]
Duration = Annotated[float, Between(0.0, LONGEST)]
OptionReward = Annotated[float, Between(-LARGEST_REWARD, LARGEST_REWARD, or_not_finite=True)]


def checks_of(kind: type) -> dict[str, Between | AtMost]:
    """Return the checks of a type's fields, by field name."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if hasattr(hint, "__metadata__")}


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
    """An OptionRequest: a robot requests its next option."""

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
    team_digest: Digest = ""
    work: Work = ""


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
    team_digest: Digest = ""


@dataclass(frozen=True)
class Grant:
    """An OptionGrant: the answer to a request; the option is `NONE` if nothing is granted."""

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
    team_digest: Digest = ""
    work: Work = ""


@dataclass(frozen=True)
class CoordinatorHeartbeat:
    """A CoordinatorStatus: announces the coordinator that decides in an epoch."""

    coordinator_epoch: CountFrom1
    team: Name = ""
    team_digest: Digest = ""


@dataclass(frozen=True, eq=False)
class JointStep:
    """A JointOptionStep: legal options (N, K) as in `Decision`, and the concatenated observations of all robots."""

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
    """Return whether two messages may belong to the same team; messages without a team, from older peers, match any."""
    return one == other or not one or not other


def same_file(one: str, other: str) -> bool:
    """Return whether two digests may be those of one team file; an empty one is unknown and matches any."""
    return one == other or not one or not other


class TeamId(NamedTuple):
    """Identity of a team in messages.

    Attributes:
        name: Name of the team, empty for unnamed.
        digest: Digest of the team's robots, options and stations, see `TeamFile.digest`; empty for unknown.
    """

    name: str = ""
    digest: str = ""


@dataclass(frozen=True)
class Answers:
    """Messages for a coordinator to send now, in this order.

    Attributes:
        grants: Answers to robots.
        steps: Joint steps, for the bag.
        heartbeat: Heartbeat for robots and other coordinators; None if not due.
    """

    grants: list[Grant] = field(default_factory=list)
    steps: list[JointStep] = field(default_factory=list)
    heartbeat: CoordinatorHeartbeat | None = None
