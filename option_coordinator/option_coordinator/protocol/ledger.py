"""The state of each robot, as far as a coordinator knows. All times are from the same clock [s].

A robot has a phase, the state of its latest request, and the time at which it was last heard. After a lease of silence
it is suspect, later lost; it keeps its phase, so that it goes on where it was if it returns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE
from option_coordinator.protocol.protocol_types import Request, Status

MOST_UNHEARD = 1000
"""Maximum number of consecutive requests that may have been lost."""


class State(StrEnum):
    """State of a robot, as far as the coordinator knows."""

    UNKNOWN = "unknown"  # never heard from
    IDLE = "idle"  # no open request, and no known option
    WAITING = "waiting"  # has asked
    GRANTED = "granted"  # has a grant that it has not acknowledged
    RUNNING = "running"  # carries it out
    SUSPECT = "suspect"  # silent for a lease
    LOST = "lost"  # silent for longer


@dataclass
class RobotState:
    """State of one robot.

    Attributes:
        agent: Name of the robot.
        incarnation: Incarnation of its process, which grows with each start; `NONE` before it is heard.
        request_id: Number of its latest valid request, 0 for none.
        grant_id: Number of its latest grant, 0 for none; grows by one with each grant.
        epoch: Epoch of the coordinator that gave the grant.
        option: Option that was granted, `NONE` for none.
        granted_at: Time at which the option began, as far as is known [s], on the clock that options are timed by.
        stamp: Stamp of the grant [s].
        cancelled: Whether the grant was cancelled, and the robot has not asked again.
        phase: State of the latest request.
        last_heard: Time at which it was heard last [s].
        told_id: Request number in its latest heartbeat, 0 before one.
        asked_at: Time at which its latest request was first heard [s].
        claims_since: Time since which it claims without a break to have seen a higher epoch [s], None if it does not.
        silence: `SUSPECT` or `LOST`, None for a robot that is heard.
        pending: Request that waits to be decided, None for none.
        repeat_at: Time at which its grant is sent again while it is not acknowledged [s].
        done: Whether it has said that its task is over.
    """

    agent: str
    incarnation: int = NONE
    request_id: int = 0
    grant_id: int = 0
    epoch: int = 0
    option: int = NONE
    granted_at: float = -math.inf
    stamp: float = 0.0
    cancelled: bool = False
    phase: State = State.UNKNOWN
    last_heard: float = -math.inf
    told_id: int = 0
    asked_at: float = -math.inf
    claims_since: float | None = None
    silence: State | None = None
    pending: Request | None = None
    repeat_at: float = -math.inf
    done: bool = False

    @property
    def state(self) -> State:
        """Its silence, if any, else its phase."""
        return self.silence or self.phase

    @property
    def holds(self) -> bool:
        """Whether it has an option, acknowledged or not."""
        return self.phase is State.RUNNING or self.phase is State.GRANTED

    @property
    def runs(self) -> bool:
        """Whether the others' choices must take its option into account."""
        return self.holds and self.silence is not State.LOST

    def answered(self, request_id: int) -> bool:
        """Whether a request was granted, whatever happened to the grant."""
        return request_id == self.request_id and self.option != NONE

    def is_past(self, incarnation: int) -> bool:
        """Whether an incarnation is over, so that its messages are late: a lower one, unless the robot is lost.

        Without the exception a robot whose clock was set back would never be heard again.
        """
        return incarnation < self.incarnation and self.silence is not State.LOST

    def is_early(self, incarnation: int) -> bool:
        """Whether it is a new incarnation while the old one is alive, which one corrupt message must not end.

        A restarted robot is accepted once its old incarnation has been silent for a lease.
        """
        return self.phase is not State.UNKNOWN and incarnation > self.incarnation and self.silence is None

    def leaps(self, request_id: int) -> bool:
        """Whether a request's number is further ahead than lost requests can explain."""
        known = max(self.request_id, self.told_id)
        return known > 0 and request_id > known + MOST_UNHEARD

    def believe_lower(self, request_id: int, now: float, patience: float) -> bool:
        """Return whether to believe a heartbeat's lower request number, and if so adopt it.

        A request may overtake a heartbeat. But a robot that still reports a lower number `patience` [s] after a request
        never sent it: somebody else did, and it would lock the robot out for good.
        """
        if now - self.asked_at <= patience:
            return False
        self.request_id, self.asked_at = request_id, now
        self._become_idle()
        self.option, self.pending = NONE, None
        return True

    def heard(self, incarnation: int, now: float) -> None:
        """Record a sign of life; a new incarnation voids the state of the old one.

        Raises:
            OptionError: the incarnation is over.
        """
        if self.is_past(incarnation):
            raise OptionError(f"'{self.agent}': incarnation {incarnation} was replaced by {self.incarnation}")
        if incarnation != self.incarnation:
            self.incarnation, self.request_id, self.told_id = incarnation, 0, 0
            self.claims_since = self.pending = None
            self.done = False
            self._become_idle()
            self.option = NONE
        self.last_heard = max(now, self.last_heard)
        self.silence = None

    def insists(self, higher: bool, incarnation: int, now: float, patience: float) -> bool:
        """Return whether it has claimed for `patience` [s], without a break, to have seen a higher epoch.

        Its next heartbeat contradicts a forged claim.
        """
        if not higher:
            self.claims_since = None
        elif incarnation == self.incarnation and self.claims_since is None:
            self.claims_since = now
        return higher and self.claims_since is not None and now - self.claims_since >= patience

    def ask(self, request_id: int, now: float) -> None:
        """Record that the robot waits for a grant: its last option has ended.

        Raises:
            OptionError: the robot was never heard, or the request is older than its last one.
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
        """Whether its unacknowledged grant or its cancellation must be sent (again) at a time [s]."""
        return (self.cancelled or self.phase is State.GRANTED) and now >= self.repeat_at

    def grant(self, epoch: int, option: int, now: float, stamp: float) -> None:
        """Grant an option that begins now, with its stamp [s].

        Raises:
            OptionError: the robot is not waiting for an option.
        """
        if self.state is not State.WAITING:
            raise OptionError(f"'{self.agent}' is {self.state}: only who waits is granted an option")
        self.epoch, self.option, self.granted_at, self.stamp = epoch, option, now, stamp
        self.grant_id += 1
        self.phase = State.GRANTED

    def acknowledge(self) -> None:
        """Record that the robot runs its granted option.

        Raises:
            OptionError: the robot has no option.
        """
        if not self.holds:
            raise OptionError(f"'{self.agent}' is {self.state}: there is no grant to acknowledge")
        self.phase = State.RUNNING

    def adopt(self, told: Status, since: float, stamp: float, now: float) -> None:
        """Adopt an option granted by another coordinator or by an earlier incarnation of this one.

        Args:
            told: Heartbeat of the robot.
            since: Time at which the option began [s].
            stamp: When the option began, by the clock of stamps [s].
            now: Time of the heartbeat [s].

        Raises:
            OptionError: it was never heard, or it has asked again since.
        """
        self._must_be_heard()
        if told.request_id < self.request_id:
            raise OptionError(f"'{self.agent}': grant of request {told.request_id}, but it has sent {self.request_id}")
        if told.request_id != self.request_id:
            self.request_id, self.asked_at = told.request_id, now
        self.epoch, self.option, self.granted_at, self.stamp = told.coordinator_epoch, told.option, since, stamp
        self.grant_id, self.cancelled, self.pending = told.grant_id, False, None
        self.phase = State.RUNNING

    def cancel(self) -> None:
        """Cancel the robot's option, which it holds until it asks again, because it may still run.

        Raises:
            OptionError: the robot has no option.
        """
        if not self.holds:
            raise OptionError(f"'{self.agent}' is {self.state}: there is no option to cancel")
        self.cancelled = True

    def end(self) -> None:
        """Record that the robot neither runs nor wants an option; the answer to its request stays known.

        Raises:
            OptionError: it was never heard.
        """
        self._must_be_heard()
        self.phase = State.IDLE  # a cancelled grant stays cancelled: a repeated request gets that answer again

    def fall_silent(self, now: float, lease: float, lost_after: float) -> bool:
        """Update its silence; return whether it is newly lost. Its request is then dropped: if alive, it asks again."""
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
        self.phase, self.cancelled = State.IDLE, False

    def _must_be_heard(self) -> None:
        if self.phase is State.UNKNOWN or self.silence is not None:
            raise OptionError(f"'{self.agent}' is {self.state}: note that it was heard first")
