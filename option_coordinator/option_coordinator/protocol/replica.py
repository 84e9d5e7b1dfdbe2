"""A coordinator as one of several replicas: receives messages from robots and coordinators, and knows if it leads.

A replica that has not run for half a lease (frozen, or on a busy machine) first stays silent to read pending messages,
because another one may have taken over. After most of a lease its epoch is over: it listens for a lease like any other
replica, and decides again only in a new epoch. No ROS, no clock.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

from option_coordinator.errors import OptionError
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.election import Election
from option_coordinator.protocol.grants import UNKNOWN_ROBOT, Refusal, other_file
from option_coordinator.protocol.ledger import RobotState, State
from option_coordinator.protocol.protocol_types import (
    Answers,
    CoordinatorHeartbeat,
    Request,
    Status,
    TeamId,
    same_file,
    same_team,
)
from option_coordinator.protocol.team import CoordinatorTimeouts
from option_coordinator.protocol.work_memory import WorkMemory

LATE = 0.5
"""Time without a tick after which a coordinator listens before continuing [leases]."""
_QUIET = 0.4
"""Duration of that listening [leases]."""
_REPLACED = 0.8
"""Time without a tick after which another replica may have taken over [leases], since the last heartbeat is older."""
_FROZEN = 8.0
"""Time without a tick after which the knowledge about the robots is too old to resume from [leases]."""


class Replica:
    """Receives the messages of its team's robots and coordinators, and determines whether it decides.

    Args:
        robots: Names of the team's robots, in the policy's order.
        timeouts: Waiting times of the coordinator.
        now: Time at which listening starts.
        seed: Seed of the epochs, as for `Election`.
        team: Name and digest of the team. A named team ignores messages of other teams; a robot whose team file has
            another digest gets no options.
        memory: What the robots carry and have delivered.

    Attributes:
        ledger: State of each robot by name, in the policy's order.
        team: Name and digest of the team.
        counts: Counters of events, for diagnostics.
    """

    def __init__(
        self,
        robots: Iterable[str],
        timeouts: CoordinatorTimeouts,
        now: ClockReading,
        seed: int | None,
        team: TeamId,
        memory: WorkMemory,
    ) -> None:
        self._names, self._timeouts, self.team = tuple(robots), timeouts, team
        self._memory = memory
        self.counts: Counter[str] = Counter()
        self._election = Election(now.steady, timeouts.lease, seed)
        self._quiet_until = -math.inf
        self._forget(now)

    @property
    def epoch(self) -> int:
        """Epoch of this coordinator; 0 while listening."""
        return self._election.epoch

    @property
    def stands_by(self) -> bool:
        """Whether another coordinator decides."""
        return self._election.stands_by

    @property
    def epochs_not_believed(self) -> int:
        """Number of epochs rejected as implausible."""
        return self._election.seen.refused

    @property
    def unheard(self) -> list[str]:
        """Robots not heard since this coordinator began to listen."""
        return [entry.agent for entry in self.ledger.values() if entry.phase is State.UNKNOWN]

    def listen(self, now: ClockReading) -> None:
        """Start over: listen to the robots for at least a lease, then take over."""
        self._election.listen(now.steady)
        self._forget(now)

    def on_coordinator_heartbeat(self, heartbeat: CoordinatorHeartbeat, now: ClockReading) -> Answers:
        """Handle the heartbeat of a coordinator, possibly its own; the answer is empty."""
        if not same_team(heartbeat.team, self.team.name):
            self.counts["words of other teams"] += 1
            return Answers()
        if not same_file(heartbeat.team_digest, self.team.digest):
            self.counts["coordinators with another team file"] += 1
        self._wake(now)
        if self._election.on_coordinator_heartbeat(heartbeat.coordinator_epoch, now.steady):
            self._step_down(now)
        return Answers()

    def _forget(self, now: ClockReading) -> None:
        """Forget all grants and start listening."""
        self._began = self._ticked_at = now.steady
        self.ledger = {name: RobotState(name) for name in self._names}

    def _knows_enough(self, now: ClockReading) -> bool:
        """Return whether every robot has been heard or had time to report, since an unheard one may run an option."""
        return not self.unheard or now.steady >= self._began + self._timeouts.lost_after

    def _wake(self, now: ClockReading) -> None:
        """Detect that this coordinator has not run for a while; keep it silent until it has caught up."""
        gap = (now.steady - self._ticked_at) / self._timeouts.lease
        if gap <= LATE:
            return
        if now.steady >= self._quiet_until:
            self.counts["late ticks"] += 1
        self._quiet_until = now.steady + _QUIET * self._timeouts.lease
        if self.epoch and gap > _REPLACED:
            self.counts["epochs given up"] += 1
            self._election.listen(now.steady)
            if gap > _FROZEN:
                self._step_down(now)

    def _decides(self, now: ClockReading) -> bool:
        """Return whether this coordinator decides and can be sure that no other one does."""
        self._wake(now)
        return bool(self.epoch) and now.steady >= self._quiet_until

    def _hear(self, told: Request | Status, now: ClockReading) -> RobotState | Refusal | None:
        """Record a sign of life, the epoch claimed in it, and the robot's work.

        Returns:
            The robot's state; or, if the message is ignored, a refusal for a robot of this team, or None.
        """
        if not same_team(told.team, self.team.name):
            self.counts["messages of other teams"] += 1
            return None
        entry = self.ledger.get(told.agent)
        if entry is None:
            self.counts["messages of unknown robots"] += 1
            own = told.team == self.team.name != ""  # a robot without a team name may belong to another team
            return UNKNOWN_ROBOT if own else None
        self._wake(now)
        self._on_claim(entry, told, now)
        if not same_file(told.team_digest, self.team.digest):
            self.counts["messages with another team file"] += 1
            return other_file(self.team.digest, told.team_digest)
        if entry.is_early(told.incarnation):
            self.counts["second lives"] += 1
            return None
        returns = entry.incarnation == told.incarnation and entry.silence is State.LOST
        try:
            entry.heard(told.incarnation, now.steady)
        except OptionError as error:
            return Refusal("old life", str(error))
        if returns:
            self.counts["returned robots"] += 1
        if isinstance(told, Request) and told.work and told.request_id >= entry.request_id:
            self.counts["works not written"] += not self._memory.keep(told.agent, told.work)
        return entry

    def _on_claim(self, entry: RobotState, told: Request | Status, now: ClockReading) -> None:
        """Record an epoch that a robot claims to have seen.

        A decider accepts the epoch once the robot has claimed it for a lease; a coordinator that may have been replaced
        accepts it at once.
        """
        epoch, sure = told.coordinator_epoch, self.epoch and now.steady >= self._quiet_until
        if sure and not entry.insists(epoch > self.epoch, told.incarnation, now.steady, self._timeouts.lease):
            return
        if self._election.on_epoch(epoch, now.steady):
            self._step_down(now)

    def _step_down(self, now: ClockReading) -> None:
        """Hand the team over to another coordinator and forget all grants, which may never have been obeyed."""
        self.counts["stepped down"] += 1
        self._forget(now)

    def _quiet(self, now: ClockReading) -> bool:
        """Record a tick; return whether to stay silent, because heartbeats may still be unread."""
        self._wake(now)
        self._ticked_at = now.steady
        return now.steady < self._quiet_until
