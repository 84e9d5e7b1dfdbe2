"""A robot's client of the coordinator: requests options, runs them, and falls back on its own. No ROS, no clock.

Under any network conditions, a robot runs one grant per request, obeys the highest epoch it has seen, and runs its safe
option if no grant arrives or an option exceeds its deadline.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from option_coordinator.errors import OptionError
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.election import Epochs
from option_coordinator.protocol.option_executor import OptionExecutor, OptionResult, Resumes
from option_coordinator.protocol.protocol_types import (
    AgentState,
    CoordinatorHeartbeat,
    Grant,
    GrantStatus,
    Request,
    Status,
    TeamId,
    same_file,
    same_team,
)
from option_coordinator.protocol.work_memory import WorkMemory


@dataclass(frozen=True)
class ClientTimeouts:
    """Periods and waiting times of a client [s], on a steady clock.

    Attributes:
        heartbeat: Heartbeat period; several must fit into a coordinator's lease.
        repeat: Repetition period of a request.
        waiting: Time without an answer after which the safe option starts.
    """

    heartbeat: float = 0.1
    repeat: float = 0.1
    waiting: float = 2.0


_WANTING = (AgentState.WAITING, AgentState.FALLBACK)


class OptionClient:
    """Communicates with the coordinator for one robot, and starts and stops its options.

    Args:
        name: Name of the robot in its team.
        options: Names of the robot's options, in order.
        executor: Executor of the options.
        incarnation: Incarnation of the robot's process, which increases with each start.
        safe_option: Index of the option to run while no grant arrives.
        timeouts: Periods and waiting times; the default ones if omitted.
        team: Name and digest of the team; without a name, that of the last accepted grant.
        memory: File that keeps the work of an executor that `Resumes`, besides the coordinator; none by default.

    Attributes:
        state: State reported in heartbeats.
        request_id: Number of the latest request.
        grant: Current or last grant; None before the first.
        finished: Whether the task is over and the coordinator has been informed.
        problem: Why the robot has no granted option, for log and diagnostics; empty if it has, or only waits.
        counts: Counters of events, for diagnostics.
    """

    def __init__(
        self,
        name: str,
        options: Sequence[str],
        executor: OptionExecutor,
        incarnation: int,
        safe_option: int = 0,
        timeouts: ClientTimeouts | None = None,
        team: TeamId | str = "",
        memory: WorkMemory | None = None,
    ) -> None:
        self.name, self.incarnation = name, incarnation
        self._options, self._executor, self._safe = tuple(options), executor, safe_option
        self._timeouts = timeouts or ClientTimeouts()
        self.state = AgentState.IDLE
        self.request_id = 0
        self.grant: Grant | None = None
        self.finished = False
        self.problem = ""
        self.counts: Counter[str] = Counter()
        self._team = TeamId(team) if isinstance(team, str) else team
        self._knows_work, self._memory = False, memory or WorkMemory()
        self._epochs = Epochs(self._timeouts.waiting)
        self._request: Request | None = None
        self._result = OptionResult()
        self._asked_at = self._began_at = 0.0
        self._request_at = self._status_at = -math.inf
        if kept := self._memory.of(name):
            self._resume(kept)

    @property
    def epoch(self) -> int:
        """Highest trusted epoch of a coordinator; 0 for none."""
        return self._epochs.highest

    def ask(self, now: ClockReading, result: OptionResult | None = None, terminated: bool = False) -> None:
        """Request an option, or report that the task is over for this robot."""
        self._result = result = result or OptionResult()
        self.state, self.finished = AgentState.WAITING, False
        self.request_id += 1
        self._asked_at = self._request_at = self._status_at = now.steady
        seen = self._executor.observe()
        if self._knows_work and not self._memory.keep(self.name, seen.work):
            self.counts["works not written"] += 1
        self._request = Request(
            stamp=now.stamp,
            agent=self.name,
            incarnation=self.incarnation,
            request_id=self.request_id,
            coordinator_epoch=self.epoch,
            observation=np.asarray(seen.observation, np.float32),
            legal=np.asarray(seen.legal, bool),
            option_reward=result.reward,
            option_duration=result.steps,
            terminated=terminated,
            team=self._team.name,
            team_digest=self._team.digest,
            work=seen.work if self._knows_work else "",
        )

    def ended(self, now: ClockReading, result: OptionResult | None = None, terminated: bool = False) -> None:
        """Report that the running option has terminated; a fall-back option just ends."""
        if self.state is AgentState.RUNNING:
            self.ask(now, result, terminated)

    def on_coordinator_heartbeat(self, heartbeat: CoordinatorHeartbeat, now: ClockReading) -> None:
        """Adopt the epoch of the team's coordinator; grants of lower epochs are ignored from now on."""
        follows = self._team.name or (self.grant.team if self.grant is not None else None)
        if heartbeat.team == follows and not self._epochs.believe(heartbeat.coordinator_epoch, now.steady):
            self.counts["epochs not believed"] += 1

    def on_grant(self, grant: Grant, now: ClockReading) -> None:
        """Handle an answer; ignore one to an older request or incarnation, of a lower epoch or of another team."""
        if (grant.agent, grant.incarnation) != (self.name, self.incarnation) or not same_team(
            grant.team, self._team.name
        ):
            return
        if grant.coordinator_epoch < self.epoch:
            self.counts["lower epochs"] += 1
            return
        if not self._epochs.believe(grant.coordinator_epoch, now.steady):
            self.counts["epochs not believed"] += 1
            return
        if grant.request_id != self.request_id:
            return
        wanting = self.state in _WANTING
        if grant.status is GrantStatus.REFUSED:
            if wanting:
                self._refused(grant, now)
        elif self._over or not self._understands(grant):
            return
        elif grant.status is GrantStatus.CANCELLED:
            self.counts["cancelled"] += 1
            self.problem = f"'{grant.option_name}' was cancelled: {grant.reason}"
            self.ask(now, self._stop())
        elif wanting:
            self._accept(grant, now)
        else:
            self._status_at = now.steady  # the coordinator has not been informed that it is running

    def tick(self, now: ClockReading) -> None:
        """Advance time: start the safe option if no grant arrives or an option exceeds its deadline."""
        if self.state is AgentState.RUNNING and self.grant and now.task - self._began_at > self.grant.deadline:
            self.counts["deadlines"] += 1
            self.problem = f"'{self._options[self.grant.option]}' exceeded its {self.grant.deadline:g} s"
            self.ask(now, self._stop())
            self._fall_back()
        elif self._waits and now.steady - self._asked_at > self._timeouts.waiting:
            self.counts["unanswered"] += 1
            self.problem = self.problem or "no coordinator answers"
            self._fall_back()

    def due_messages(self, now: ClockReading) -> list[Request | Status]:
        """Return the messages to send now, in order."""
        out: list[Request | Status] = []
        if self.state in _WANTING and self._request is not None and now.steady >= self._request_at:
            self._request_at = now.steady + self._timeouts.repeat
            self._request = replace(self._request, coordinator_epoch=self.epoch)
            out.append(self._request)
        if now.steady >= self._status_at:
            self._status_at = now.steady + self._timeouts.heartbeat
            out.append(self._status(now))
        return out

    @property
    def _waits(self) -> bool:
        return self.state is AgentState.WAITING and not self._over

    @property
    def _over(self) -> bool:
        return self._request is not None and self._request.terminated

    def _understands(self, grant: Grant) -> bool:
        """Return whether the coordinator means the robot's own options; otherwise say so and ignore the grant."""
        own = self._options[grant.option] if 0 <= grant.option < len(self._options) else ""
        if not same_file(grant.team_digest, self._team.digest):
            digests = f"digest {grant.team_digest[:12]}, this robot's {self._team.digest[:12]}"
            self.problem = f"the coordinator's team file differs ({digests}): give both the same file"
            self.counts["grants of another team file"] += 1
        elif not own or grant.deadline <= 0.0:
            self.counts["impossible grants"] += 1
        elif grant.option_name not in ("", own):
            theirs = f"option {grant.option} is '{grant.option_name}' for the coordinator"
            self.problem = f"{theirs} and '{own}' here: give both the same options"
            self.counts["grants of other options"] += 1
        else:
            return True
        return False

    def _accept(self, grant: Grant, now: ClockReading) -> None:
        self._knows_work, self.problem = True, ""
        if self.state is AgentState.FALLBACK:
            self._executor.leave()
        self.state, self.grant = AgentState.RUNNING, grant
        self._began_at, self._status_at = now.task, now.steady
        self._executor.begin(grant.option)

    def _refused(self, grant: Grant, now: ClockReading) -> None:
        """Repeat the request at once if only the epoch was unknown; otherwise make a new request and observation.

        A request never changes; otherwise the legal options would depend on which copy was answered.
        """
        self.counts["refused"] += 1
        if self._over:
            self.state, self.finished, self.problem = AgentState.IDLE, True, ""
            self._memory.forget(self.name)
        elif self._request is not None and grant.coordinator_epoch > self._request.coordinator_epoch:
            self._request_at = now.steady
        else:
            self.problem = f"refused: {grant.reason}"
            if grant.work and not self._knows_work:
                self._resume(grant.work)
            state, asked_at = self.state, self._asked_at
            self.ask(now, self._result)
            self.state, self._asked_at, self._request_at = state, asked_at, now.steady + self._timeouts.repeat

    def _resume(self, work: str) -> None:
        """Take over the work that the coordinator, or a file, has kept."""
        self.problem = f"there is kept work that this robot cannot take over: {work!r}"
        if isinstance(self._executor, Resumes):
            with suppress(OptionError):
                self._executor.resume(work)
                self._knows_work, self.problem = True, ""

    def _fall_back(self) -> None:
        self.state = AgentState.FALLBACK
        self._executor.begin(self._safe)

    def _stop(self) -> OptionResult:
        """Stop the running option; the reward of a safe option without a grant does not count."""
        if self.state not in (AgentState.RUNNING, AgentState.FALLBACK):
            return OptionResult()
        result = self._executor.leave()
        return result if self.state is AgentState.RUNNING else OptionResult()

    def _status(self, now: ClockReading) -> Status:
        grant, runs = self.grant, self.state is AgentState.RUNNING
        return Status(
            agent=self.name,
            incarnation=self.incarnation,
            state=self.state,
            coordinator_epoch=grant.coordinator_epoch if grant and runs else self.epoch,
            request_id=self.request_id,
            grant_id=grant.grant_id if grant else 0,
            option=grant.option if grant else 0,
            elapsed=now.task - self._began_at if grant and runs else 0.0,
            team=self._team.name,
            team_digest=self._team.digest,
        )
