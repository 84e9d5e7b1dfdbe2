"""A task of a team, and the states it goes through. Times are stamps of the ROS clock [s]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from option_coordinator.errors import OptionError
from option_coordinator.protocol.protocol_types import LONGEST_NAME

DELIVERY = "delivery"
"""The kind of task that delivery teams do: fetch a parcel at one station and deliver it at another."""
HIGHEST_PRIORITY = 1000
PRIORITY_S = 60.0
"""Waiting time that one step of priority is worth [s]."""


class TaskState(IntEnum):
    """State of a task: constants of WorkState.state."""

    SUBMITTED = 0
    REFUSED = 1  # nobody can do it
    WAITING = 2  # accepted; no robot yet
    ASSIGNED = 3  # the robot is on its way to the origin
    ON_BOARD = 4  # the robot is on its way to the destination
    DONE = 5
    CANCELLED = 6
    FAILED = 7  # accepted but not done

    @property
    def words(self) -> str:
        """The state in words."""
        return self.name.lower().replace("_", " ")


_S = TaskState
TRANSITIONS = MappingProxyType(
    {
        _S.SUBMITTED: frozenset({_S.WAITING, _S.REFUSED}),
        _S.REFUSED: frozenset({_S.SUBMITTED}),
        _S.WAITING: frozenset({_S.ASSIGNED, _S.CANCELLED, _S.FAILED}),
        _S.ASSIGNED: frozenset({_S.ON_BOARD, _S.WAITING, _S.CANCELLED}),
        _S.ON_BOARD: frozenset({_S.DONE, _S.FAILED}),
        _S.DONE: frozenset(),
        _S.CANCELLED: frozenset(),
        _S.FAILED: frozenset(),
    }
)
"""Which states may follow each state."""
OPEN = (_S.SUBMITTED, _S.WAITING, _S.ASSIGNED, _S.ON_BOARD)
"""States of tasks that are not finished."""


@dataclass(frozen=True)
class Task:
    """Something to bring from one station to another.

    Attributes:
        id: Identity, chosen by whoever submits the task.
        origin: Station to fetch at.
        destination: Station to deliver at.
        kind: What is to be done.
        priority: Tasks of higher priority go first.
        earliest: Time before which no robot fetches [s].
        latest: Time at which the task must be done [s]; infinite for no limit.
        skill: Skill that the robot needs; empty for none.

    Raises:
        OptionError: A value is out of range.
    """

    id: str
    origin: str
    destination: str
    kind: str = DELIVERY
    priority: int = 0
    earliest: float = 0.0
    latest: float = math.inf
    skill: str = ""

    def __post_init__(self) -> None:
        if not self.id:
            raise OptionError("a task needs an id: by it, a repeated submission is known")
        for name in ("id", "origin", "destination", "kind", "skill"):
            if len(getattr(self, name).encode(errors="replace")) > LONGEST_NAME:
                raise OptionError(f"task {self.id[:40]!r}: its {name} has more than {LONGEST_NAME} bytes")
        if abs(self.priority) > HIGHEST_PRIORITY:
            limits = f"{-HIGHEST_PRIORITY} to {HIGHEST_PRIORITY}"
            raise OptionError(f"task {self.id!r}: its priority is {self.priority}, must be {limits}")
        if not math.isfinite(self.earliest) or math.isnan(self.latest):
            raise OptionError(f"task {self.id!r}: its times are not finite")


@dataclass(frozen=True)
class Change:
    """A change of a task, as the history has it.

    Attributes:
        number: Number of the change among all changes of the file, from 1.
        at: Time of the change [s].
        task: The task after the change.
        state: Its state after the change.
        robot: Robot that has the task, or had it last; empty before the first.
        reason: Why the task is in this state; may be empty.
        base: Deliveries that the robot had made when it was assigned.
        submitted: Time at which the task was submitted [s].
    """

    number: int
    at: float
    task: Task
    state: TaskState
    robot: str = ""
    reason: str = ""
    base: int = 0
    submitted: float = 0.0
