"""The state of each robot as known to a coordinator. All times are from the same clock [s].

A robot has a phase (the state of its latest request) and the time at which it was last heard. After a lease of silence
it is suspect, later lost; it keeps its phase, so that it can continue if it returns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE
from option_coordinator.protocol.protocol_types import Request, Status

TOO_LONG = "it exceeds its maximum duration: send a new request"
MOST_UNHEARD = 1000
"""Maximum number of consecutive requests that may have been lost."""


class State(StrEnum):
    """State of a robot, as known to the coordinator."""

    UNKNOWN = "unknown"  # no message received yet
    IDLE = "idle"  # no open request, and no known option
    WAITING = "waiting"  # has sent a request
    GRANTED = "granted"  # has a grant that is not yet acknowledged
    RUNNING = "running"  # runs the granted option
    SUSPECT = "suspect"  # silent for a lease
    LOST = "lost"  # silent for longer


@dataclass
class RobotState:
    """State of one robot.

    Attributes:
        agent: Name of the robot.
        incarnation: Incarnation of the robot's process, which increases with each start; `NONE` before the first
            message.
        request_id: Number of the latest valid request; 0 for none.
        grant_id: Number of the latest grant, incremented with each grant; 0 for none.
        epoch: Epoch of the coordinator that issued the grant.
        option: Granted option; `NONE` for none.
        granted_at: Start time of the option, as far as known [s], in task time.
        stamp: Stamp of the grant [s].
        cancelled: Why the grant was cancelled, until the robot sends a new request; empty if it was not.
        phase: State of the latest request.
        last_heard: Time of the last message [s].
        told_id: Request number in the latest heartbeat; 0 before the first.
        asked_at: Time at which the latest request was first received [s].
        claims_since: Time since which the robot has continuously claimed to have seen a higher epoch [s]; None if it
            does not.
        silence: `SUSPECT` or `LOST`; None for a reachable robot.
        pending: Request awaiting a decision; None for none.
        repeat_at: Time at which an unacknowledged grant is sent again [s].
        done: Whether the robot has reported the end of its task.
        given_up: Why the robot gets no more options, see `OverrunLimit.verdict`; empty if it does.
    """

    agent: str
    incarnation: int = NONE
    request_id: int = 0
    grant_id: int = 0
    epoch: int = 0
    option: int = NONE
    granted_at: float = -math.inf
    stamp: float = 0.0
    cancelled: str = ""
    phase: State = State.UNKNOWN
    last_heard: float = -math.inf
    told_id: int = 0
    asked_at: float = -math.inf
    claims_since: float | None = None
    silence: State | None = None
    pending: Request | None = None
    repeat_at: float = -math.inf
    done: bool = False
    given_up: str = ""

    @property
    def state(self) -> State:
        """The robot's silence state, if any, else its phase."""
        return self.silence or self.phase

    @property
    def holds(self) -> bool:
        """Whether the robot has an option, acknowledged or not."""
        return self.phase is State.RUNNING or self.phase is State.GRANTED

    @property
    def runs(self) -> bool:
        """Whether the other robots' choices must take this robot's option into account."""
        return self.holds and self.silence is not State.LOST

    def answered(self, request_id: int) -> bool:
        """Return whether a request was granted, regardless of what happened to the grant."""
        return request_id == self.request_id and self.option != NONE

    def is_past(self, incarnation: int) -> bool:
        """Return whether an incarnation is over and its messages are late: a lower one, unless the robot is lost.

        Without the exception, a robot whose clock was set back would be ignored forever.
        """
        return incarnation < self.incarnation and self.silence is not State.LOST

    def is_early(self, incarnation: int) -> bool:
        """Return whether a new incarnation appears while the old one is alive, possibly due to a corrupt message.

        A restarted robot is accepted once its old incarnation has been silent for a lease.
        """
        return self.phase is not State.UNKNOWN and incarnation > self.incarnation and self.silence is None

    def leaps(self, request_id: int) -> bool:
        """Return whether a request's number is further ahead than lost requests can explain."""
        known = max(self.request_id, self.told_id)
        return known > 0 and request_id > known + MOST_UNHEARD

    def believe_lower(self, request_id: int, now: float, patience: float) -> bool:
        """Return whether to trust a heartbeat's lower request number, and if so adopt it.

        A request may overtake a heartbeat. But if a robot still reports a lower number `patience` [s] after a request,
        that request was forged, and would lock the robot out permanently.
        """
        if now - self.asked_at <= patience:
            return False
        self.request_id, self.asked_at = request_id, now
        self._become_idle()
        self.option, self.pending = NONE, None
        return True

    def heard(self, incarnation: int, now: float) -> None:
        """Record a sign of life; a new incarnation invalidates the state of the old one.

        Raises:
            OptionError: The incarnation is over.
        """
        if self.is_past(incarnation):
            raise OptionError(f"'{self.agent}': incarnation {incarnation} was replaced by {self.incarnation}")
        if incarnation != self.incarnation:
            self.incarnation, self.request_id, self.told_id = incarnation, 0, 0
            self.claims_since = self.pending = None
            self.done, self.given_up = False, ""
            self._become_idle()
            self.option = NONE
        self.last_heard = max(now, self.last_heard)
        self.silence = None

    def insists(self, higher: bool, incarnation: int, now: float, patience: float) -> bool:
        """Return whether the robot has continuously claimed for `patience` [s] to have seen a higher epoch.

        A forged claim is contradicted by the robot's next heartbeat.
        """
        if not higher:
            self.claims_since = None
        elif incarnation == self.incarnation and self.claims_since is None:
            self.claims_since = now
        return higher and self.claims_since is not None and now - self.claims_since >= patience

    def ask(self, request_id: int, now: float) -> None:
        """Record that the robot's last option has ended and it is waiting for a grant.

        Raises:
            OptionError: The robot was never heard, or the request is older than its last one.
        """
        self._must_be_heard()
        if request_id < self.request_id or self.answered(request_id):
            raise OptionError(f"'{self.agent}': request {request_id} is not after {self.request_id}")
        if request_id != self.request_id:
            self.request_id, self.asked_at = request_id, now
        self._become_idle()
        self.option = NONE
        self.phase = State.WAITING

    def must_be_told(self, now: float) -> bool:
        """Return whether an unacknowledged grant or a cancellation must be sent (again) at a time [s]."""
        return (bool(self.cancelled) or self.phase is State.GRANTED) and now >= self.repeat_at

    def grant(self, epoch: int, option: int, now: float, stamp: float) -> None:
        """Grant an option that starts now, with its stamp [s].

        Raises:
            OptionError: The robot is not waiting for an option.
        """
        if self.state is not State.WAITING:
            raise OptionError(f"'{self.agent}' is {self.state}: only a waiting robot is granted an option")
        self.epoch, self.option, self.granted_at, self.stamp = epoch, option, now, stamp
        self.grant_id += 1
        self.phase = State.GRANTED

    def acknowledge(self) -> None:
        """Record that the robot runs its granted option.

        Raises:
            OptionError: The robot has no option.
        """
        if not self.holds:
            raise OptionError(f"'{self.agent}' is {self.state}: there is no grant to acknowledge")
        self.phase = State.RUNNING

    def adopt(self, told: Status, since: float, stamp: float, now: float) -> None:
        """Adopt an option granted by another coordinator or by an earlier incarnation of this one.

        Args:
            told: Heartbeat of the robot.
            since: Start time of the option [s].
            stamp: Start time of the option on the clock of the stamps [s].
            now: Time of the heartbeat [s].

        Raises:
            OptionError: The robot was never heard, or has sent a new request since.
        """
        self._must_be_heard()
        if told.request_id < self.request_id:
            raise OptionError(f"'{self.agent}': grant of request {told.request_id}, but it has sent {self.request_id}")
        if told.request_id != self.request_id:
            self.request_id, self.asked_at = told.request_id, now
        self.epoch, self.option, self.granted_at, self.stamp = told.coordinator_epoch, told.option, since, stamp
        self.grant_id, self.cancelled, self.pending = told.grant_id, "", None
        self.phase = State.RUNNING

    def cancel(self, reason: str = TOO_LONG) -> None:
        """Cancel the robot's option, which stays reserved until the next request because it may still be running.

        The coordinator tells the robot in its next ticks.

        Raises:
            OptionError: The robot has no option.
        """
        if not self.holds:
            raise OptionError(f"'{self.agent}' is {self.state}: there is no option to cancel")
        self.cancelled = reason

    def end(self) -> None:
        """Record that the robot neither runs nor requests an option; the answer to its last request is kept.

        Raises:
            OptionError: The robot was never heard.
        """
        self._must_be_heard()
        self.phase = State.IDLE  # a cancelled grant stays cancelled: a repeated request gets the same answer

    def fall_silent(self, now: float, lease: float, lost_after: float) -> bool:
        """Update the silence state; return whether the robot is newly lost. A lost robot's request is dropped."""
        silent = now - self.last_heard
        if self.phase is State.UNKNOWN or self.silence is State.LOST or silent < lease:
            return False
        self.silence = State.LOST if silent >= lost_after else State.SUSPECT
        if self.silence is not State.LOST:
            return False
        self.pending = None
        if self.phase is State.WAITING:
            self._become_idle()
        return True

    def _become_idle(self) -> None:
        self.phase, self.cancelled = State.IDLE, ""

    def _must_be_heard(self) -> None:
        if self.phase is State.UNKNOWN or self.silence is not None:
            raise OptionError(f"'{self.agent}' is {self.state}: call heard() first")


def all_wait(robots: Iterable[RobotState]) -> bool:
    """Return whether every reachable robot is waiting, so that no further request can arrive."""
    return all(robot.phase in (State.WAITING, State.UNKNOWN) or robot.silence is not None for robot in robots)


def any_at_work(robots: Iterable[RobotState]) -> bool:
    """Return whether a robot runs an option or waits for one."""
    return any(robot.runs or robot.state is State.WAITING for robot in robots)
