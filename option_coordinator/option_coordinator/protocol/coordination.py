"""A coordinator that grants options to robots on request when they are ready (thesis Algorithm 3). No ROS, no clock.

Before it decides anything, a coordinator listens for a lease, until no other coordinator decides (see `election`) and
every robot has been heard. Robots report their running option and the highest epoch they have seen; the coordinator
takes a higher epoch, and robots obey only the highest. The coordinator trusts these reports: a grant in transit when
another coordinator died is adopted, never issued twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from option_coordinator.options.options import NONE
from option_coordinator.policies.policy_query import PolicyFn, query_with_fallback
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.grants import (
    NOTHING_SAFE,
    NUMBER_LEAPS,
    TASK_OVER,
    EpisodeRecorder,
    Refusal,
    kept_work,
    refusal_of,
    refused_grant,
    standing_grant,
)
from option_coordinator.protocol.ledger import RobotState, State, all_wait, any_at_work
from option_coordinator.protocol.overruns import OverrunLimit
from option_coordinator.protocol.protocol_types import (
    AgentState,
    Answers,
    CoordinatorHeartbeat,
    Grant,
    GrantStatus,
    JointStep,
    Request,
    Status,
    TeamId,
)
from option_coordinator.protocol.replica import Replica
from option_coordinator.protocol.team import CoordinatorTimeouts, RobotSpec, TeamQuery
from option_coordinator.protocol.work_memory import WorkMemory


class Coordinator(Replica):
    """Makes the decisions for a team. Its methods return the messages to send; call `tick` every few milliseconds.

    Args:
        robots: Robots, in the policy's order.
        policy: Policy to query, see `policy_query`.
        digest: SHA-256 (hex) of the policy's file, empty for a policy without one.
        now: Time at which the coordinator begins to listen.
        timeouts: Waiting times and limits; the default ones if omitted.
        seed: Seed of the epochs, see `Election`; random by default.
        discount: Discount factor gamma of a low-level step.
        team: Name and digest of the team, see `Replica`; a name alone is a team without a digest.
        memory: What the robots carry and have delivered; by default kept in memory only.

    Attributes:
        digest: SHA-256 (hex) of the policy's file, empty for a policy without one.
    """

    def __init__(
        self,
        robots: Sequence[RobotSpec],
        policy: PolicyFn,
        digest: str,
        now: ClockReading,
        timeouts: CoordinatorTimeouts | None = None,
        seed: int | None = None,
        discount: float = 1.0,
        team: TeamId | str = "",
        memory: WorkMemory | None = None,
    ) -> None:
        self._robots = {robot.agent.name: robot for robot in robots}
        self._policy, self.digest = policy, digest
        self._discount = discount
        timeouts = timeouts or CoordinatorTimeouts()
        self._overruns = OverrunLimit(timeouts.most_overruns)
        self._query = TeamQuery(robots, self._overruns)
        team = TeamId(team) if isinstance(team, str) else team
        super().__init__(self._robots, timeouts, now, seed, team, memory or WorkMemory())

    @property
    def batches(self) -> bool:
        """Whether a request is waiting to be decided together with others."""
        return self._due < math.inf

    def replace_policy(self, policy: PolicyFn, digest: str) -> None:
        """Use another policy from the next decision on."""
        self._policy, self.digest = policy, digest
        self.counts["policies replaced"] += 1

    def on_request(self, request: Request, now: ClockReading) -> Answers:
        """Handle a request: repeat its answer, reject it, or decide it, now or in `end_batch`."""
        entry = self._hear(request, now)
        if isinstance(entry, Refusal):
            return self._refuse(request, now, entry) if self._decides(now) else Answers()
        if entry is None:
            return Answers()
        agent = self._robots[request.agent].agent
        refusal = refusal_of(request, agent, self.epoch, now.stamp - request.stamp, self._timeouts.stale)
        if self._decides(now):
            return self._answer(entry, request, refusal, now)
        if refusal is None:  # the robot repeats its request, and its heartbeats report its option
            self._query.observe(request)
        return Answers()

    def on_status(self, status: Status, now: ClockReading) -> Answers:
        """Handle a heartbeat: a sign of life, an acknowledgement, or news about a robot's running option."""
        entry = self._hear(status, now)
        if not isinstance(entry, RobotState):
            return Answers()
        if entry.leaps(status.request_id):
            self.counts["request number leaps"] += 1
            entry.told_id = status.request_id  # its next heartbeat decides who is right
            return Answers()
        entry.told_id = status.request_id
        if status.request_id < entry.request_id:
            if not entry.believe_lower(status.request_id, now.steady, self._timeouts.lost_after):
                return Answers()  # sent before the request
            self.counts["requests that were not the robot's"] += 1
        if status.state is AgentState.RUNNING:
            self._believe(entry, status, now)
        elif entry.holds and (status.state is AgentState.IDLE or status.request_id > entry.request_id):
            entry.end()
        return Answers()

    def tick(self, now: ClockReading) -> Answers:
        """Advance time: take over, decide, repeat unacknowledged grants, cancel options that exceed their deadline."""
        if self._quiet(now):
            return Answers()
        for entry in self.ledger.values():
            if entry.fall_silent(now.steady, self._timeouts.lease, self._timeouts.lost_after):
                self.counts["lost robots"] += 1
        listened = not self.epoch
        heartbeat_due = self._election.tick(now.steady, self._knows_enough(now))
        if not self.epoch:
            return Answers()
        if listened:
            self._recorder = self._new_recorder(now)
        grants = [grant for entry in self.ledger.values() for grant in self._overdue(entry, now)]
        decided = self._decide_when_due(now)
        return Answers(
            grants + decided.grants,
            decided.steps,
            CoordinatorHeartbeat(self.epoch, *self.team) if heartbeat_due else None,
        )

    def end_batch(self, now: ClockReading) -> Answers:
        """Decide all requests whose batch window has ended."""
        return self._decide_when_due(now) if self._decides(now) else Answers()

    def close(self, now: ClockReading) -> Answers:
        """End the episode; return its last step if an episode is open."""
        return Answers(steps=[self._last_step(now, terminated=False)] if self.epoch and self._recorder.open else [])

    def _forget(self, now: ClockReading) -> None:
        super()._forget(now)
        self._recorder = self._new_recorder(now)
        self._due = math.inf

    def _new_recorder(self, now: ClockReading) -> EpisodeRecorder:
        return EpisodeRecorder(now.task, self._timeouts.time_step, self._discount)

    def _answer(self, entry: RobotState, request: Request, refusal: Refusal | None, now: ClockReading) -> Answers:
        """Answer the request of a known robot in this epoch."""
        if request.coordinator_epoch > self.epoch:  # the robot would ignore it
            self.counts["requests of higher epochs"] += 1
            return Answers()
        if entry.leaps(request.request_id):
            return self._refuse(request, now, NUMBER_LEAPS)
        if entry.answered(request.request_id):
            self.counts["duplicate requests"] += 1
            return Answers([self._grant_of(entry, now)])
        if request.request_id < entry.request_id:
            return self._refuse(request, now, Refusal("old request", f"request {entry.request_id} has been sent since"))
        if request.terminated:
            return self._finish(entry, request, now)
        if refusal is not None:
            return self._refuse(request, now, refusal)
        if not request.work and (kept := self._memory.of(request.agent)):
            return self._refuse(request, now, kept_work(kept))
        self._credit(entry, request, now)
        robot = self._robots[request.agent]
        entry.given_up = self._overruns.verdict(robot.agent, request.legal, robot.safe_option)
        if entry.given_up:
            return self._retire(entry, request, Refusal("given up", entry.given_up), now)
        entry.ask(request.request_id, now.steady)
        entry.pending, entry.done = request, False
        self._due = min(self._due, now.steady + self._timeouts.batch_window)
        self._query.observe(request)
        return self._decide(now) if all_wait(self.ledger.values()) else Answers()

    def _refuse(self, request: Request, now: ClockReading, refusal: Refusal) -> Answers:
        self.counts[f"refused: {refusal.kind}"] += 1
        return Answers([refused_grant(request, refusal, self.epoch, self.team, now)])

    def _credit(self, entry: RobotState, request: Request, now: ClockReading) -> None:
        """Credit the reward of the robot's last option, exactly once, and record whether the option overran."""
        if not entry.request_id:  # it has restarted
            self._overruns.forget(entry.agent)
        if entry.option == NONE:
            return
        longest = self._robots[entry.agent].durations[entry.option]
        self._overruns.ended(entry.agent, entry.option, now.task, longest)
        if not self._recorder.credit(request.option_reward, entry.granted_at, longest):
            self.counts["rewards too large"] += 1

    def _finish(self, entry: RobotState, request: Request, now: ClockReading) -> Answers:
        """Record that a robot's task is over; the last robot's report ends the episode."""
        if entry.done:
            return self._refuse(request, now, TASK_OVER)
        if math.isfinite(request.option_reward):
            self._credit(entry, request, now)
        entry.done = True
        return self._retire(entry, request, TASK_OVER, now)

    def _retire(self, entry: RobotState, request: Request, refusal: Refusal, now: ClockReading) -> Answers:
        """Record that a robot gets no more options; when none is at work any more, the episode ends."""
        entry.ask(request.request_id, now.steady)
        entry.end()
        entry.pending = None
        grants = self._refuse(request, now, refusal).grants
        given_up = any(e.given_up for e in self.ledger.values())
        if any_at_work(self.ledger.values()) or (given_up and not self._recorder.open):
            return Answers(grants)
        for other in self.ledger.values():
            if other.done:
                self._memory.forget(other.agent)
        return Answers(grants, [self._last_step(now, terminated=not given_up)])

    def _believe(self, entry: RobotState, status: Status, now: ClockReading) -> None:
        """Record an acknowledgement, or adopt a grant of another coordinator."""
        durations = self._robots[entry.agent].durations
        if not 0 <= status.option < len(durations) or status.grant_id < 1:
            self.counts["impossible statuses"] += 1
            return
        elapsed = min(status.elapsed, durations[status.option])
        told = (status.coordinator_epoch, status.request_id, status.grant_id, status.option)
        if entry.option != NONE and told == (entry.epoch, entry.request_id, entry.grant_id, entry.option):
            if entry.phase is State.GRANTED:
                entry.acknowledge()
                entry.granted_at = max(entry.granted_at, now.task - elapsed)
            return
        entry.adopt(status, now.task - elapsed, now.stamp - elapsed, now.steady)
        self.counts["adopted grants"] += 1

    def _overdue(self, entry: RobotState, now: ClockReading) -> list[Grant]:
        """Return the grant or cancellation due for a robot, possibly a repetition."""
        if not entry.runs:
            return []
        duration = self._robots[entry.agent].durations[entry.option]
        if not entry.cancelled and now.task - entry.granted_at > duration:
            entry.cancel()
            self.counts["overruns"] += 1
            entry.repeat_at = now.steady
        if not entry.must_be_told(now.steady):
            return []
        entry.repeat_at = now.steady + self._timeouts.repeat
        return [self._grant_of(entry, now)]

    def _grant_of(self, entry: RobotState, now: ClockReading) -> Grant:
        return standing_grant(entry, self._robots[entry.agent], self.epoch, self.team, now)

    def _decide_when_due(self, now: ClockReading) -> Answers:
        return self._decide(now) if now.steady >= self._due else Answers()

    def _decide(self, now: ClockReading) -> Answers:
        """Decide for all reachable waiting robots; a silent robot asks again when it returns."""
        self._due = math.inf
        waiting = (entry for entry in self.ledger.values() if entry.state is State.WAITING)
        requests = {entry.agent: entry.pending for entry in waiting if entry.pending is not None}
        query = self._query.of(requests, self.ledger)
        answer = query_with_fallback(query, self._policy, self._timeouts.policy_limit, self._query.safe_options)
        self.counts.update(answer.faults)
        grants, running = [], query.running.copy()
        for name, request in requests.items():
            entry, index = self.ledger[name], self._query.index[name]
            entry.pending, option = None, int(answer.options[index])
            if option < 0:
                entry.end()
                grants += self._refuse(request, now, NOTHING_SAFE).grants
                continue
            entry.grant(self.epoch, option, now.task, now.stamp)
            self._overruns.began(name, option, now.task)
            entry.repeat_at = now.steady + self._timeouts.repeat
            running[index] = option
            grants.append(self._grant_of(entry, now))
        if all(grant.status is GrantStatus.REFUSED for grant in grants):
            return Answers(grants)
        digest = self.digest if answer.by_policy else ""
        return Answers(grants, [self._recorder.step(now, self.epoch, query, running, answer.log_probability, digest)])

    def _last_step(self, now: ClockReading, terminated: bool) -> JointStep:
        query = self._query.of({}, self.ledger)
        return self._recorder.step(
            now, self.epoch, query, query.running, terminated=terminated, truncated=not terminated
        )
