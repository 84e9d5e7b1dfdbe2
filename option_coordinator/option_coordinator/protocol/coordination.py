"""Grants options to robots that ask when they are ready (thesis Algorithm 3, deployed). Pure: no ROS, and no clock.

A coordinator listens for a lease before it decides anything, and for as long as another one does (see `election`) or
it waits for a robot's first word: robots say what they run, and which epoch they have seen; its own is above that, and
robots obey the highest only. What a robot says that it carries out is true: a grant that was on its way when a
coordinator died is adopted, never doubled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from option_coordinator.errors import OptionError
from option_coordinator.options.decision import NONE
from option_coordinator.options.options import option_mask
from option_coordinator.policies.joint_policy import JointOptions
from option_coordinator.policies.policy_query import PolicyFn, PolicyQuery, query_with_fallback
from option_coordinator.protocol.clock_reading import ClockReading
from option_coordinator.protocol.journal import Journal
from option_coordinator.protocol.ledger import Entry, State
from option_coordinator.protocol.protocol_types import (
    AgentState,
    Answers,
    CoordinatorHeartbeat,
    Grant,
    GrantStatus,
    JointStep,
    Request,
    Status,
)
from option_coordinator.protocol.refusal import Refusal, refusal_of
from option_coordinator.protocol.replica import Replica
from option_coordinator.protocol.team_settings import CoordinatorTimeouts, RobotSpec

_UNKNOWN_ROBOT = Refusal("unknown robot", "this team has no such robot")
_TASK_OVER = Refusal("task over", "the task is over")
_NOTHING_SAFE = Refusal("nothing safe", "policy failed, and the safe option is not legal")
_LEAP = Refusal("request number leaps", "request_id grows by one per request: so many cannot have been missed")


class Coordinator(Replica):
    """Decides for a team. Its methods return what is to be sent; `tick` is to be called often, each millisecond or so.

    Args:
        robots: in the policy's order.
        policy: chooses, see `choice`.
        digest: of its file.
        now: when it begins.
        timeouts: Waiting times of the coordinator.
        seed: of its epochs, see `Election`.
        discount: gamma of a low-level step.
        team: Name of the team; words of other teams mean nothing. Empty for unnamed: all words count.

    Attributes:
        digest: of the policy's file, empty for one that has none.
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
        team: str = "",
    ) -> None:
        self._robots = {robot.agent.name: robot for robot in robots}
        self._index = {name: index for index, name in enumerate(self._robots)}
        self._policy, self.digest = policy, digest
        self._discount = discount
        self._options = option_mask([len(robot.agent.options) for robot in robots])
        ends = np.cumsum([robot.agent.observation_size for robot in robots]).tolist()
        self._places = {name: slice(*ends) for name, ends in zip(self._robots, pairwise([0, *ends]), strict=True)}
        self._observed = np.zeros(ends[-1], np.float32)
        self._batch_at = math.inf
        super().__init__(self._robots, timeouts or CoordinatorTimeouts(), now, seed, team)

    @property
    def batches(self) -> bool:
        """Whether a request waits for others to be decided with."""
        return self._batch_at < math.inf

    def replace_policy(self, policy: PolicyFn, digest: str) -> None:
        """Decide by another policy from the next decision on."""
        self._policy, self.digest = policy, digest
        self.counts["policies replaced"] += 1

    def on_request(self, request: Request, now: ClockReading) -> Answers:
        """Take a request: it is answered as before, refused with a reason, or decided, at once or by `end_batch`."""
        entry = self._entry(request)
        if entry is None:
            own = request.team == self.team != ""  # who names no team may be another one's
            return self._refuse(request, now, _UNKNOWN_ROBOT) if own and self._decides(now) else Answers()
        self._wake(now)
        self._on_claim(entry, request.incarnation, request.coordinator_epoch, now)
        try:
            if not self._hear(entry, request.incarnation, now):
                return Answers()
        except OptionError as error:
            return self._refuse(request, now, Refusal("old life", str(error))) if self._decides(now) else Answers()
        agent = self._robots[request.agent].agent
        refusal = refusal_of(request, agent, self.epoch, now.stamp - request.stamp, self._timeouts.stale)
        if not self._decides(now):  # it asks again; what it runs, its status says
            if refusal is None:
                self._observe(request)
            return Answers()
        if request.coordinator_epoch > self.epoch:  # it would not obey
            self.counts["requests of higher epochs"] += 1
            return Answers()
        if entry.leaps(request.request_id):
            return self._refuse(request, now, _LEAP)
        if entry.answered(request.request_id):
            self.counts["duplicate requests"] += 1
            return Answers([self._grant_of(entry, now)])
        if request.request_id < entry.request_id:
            return self._refuse(request, now, Refusal("old request", f"request {entry.request_id} has been sent since"))
        if request.terminated:
            return self._finish(entry, request, now)
        if refusal is not None:
            return self._refuse(request, now, refusal)
        self._credit(entry, request)
        self._done.discard(entry.agent)
        entry.ask(request.request_id, now.steady)
        self._open[entry.agent] = request
        self._observe(request)
        self._batch_at = min(self._batch_at, now.steady + self._timeouts.batch_window)
        # One decision serves all that ask at about the same time: one for each would cost 50 robots most of their time.
        return self._decide(now) if self._all_wait() else Answers()

    def on_status(self, status: Status, now: ClockReading) -> Answers:
        """Take a heartbeat: a sign of life, an acknowledgement, or news of what a robot runs."""
        entry = self._entry(status)
        if entry is None:
            return Answers()
        self._wake(now)
        self._on_claim(entry, status.incarnation, status.coordinator_epoch, now)
        try:
            if not self._hear(entry, status.incarnation, now):
                return Answers()
        except OptionError:
            return Answers()
        if entry.leaps(status.request_id):
            self.counts["request number leaps"] += 1
            entry.told_id = status.request_id  # who is right, its next heartbeat says
            return Answers()
        entry.told_id = status.request_id
        if status.request_id < entry.request_id:
            if not entry.believe_lower(status.request_id, now.steady, self._timeouts.lost_after):
                return Answers()  # it was sent before the request
            self._open.pop(entry.agent, None)
            self.counts["requests that were not the robot's"] += 1
        if status.state is AgentState.RUNNING:
            self._believe(entry, status, now)
        elif entry.holds and (status.state is AgentState.IDLE or status.request_id > entry.request_id):
            entry.end()
        return Answers()

    def tick(self, now: ClockReading) -> Answers:
        """Let time pass: take over, decide, repeat what was not acknowledged, call off what takes too long."""
        if self._quiet(now):
            return Answers()
        for entry in self.ledger:
            if entry.fall_silent(now.steady, self._timeouts.lease, self._timeouts.lost_after):
                self.counts["lost robots"] += 1
                self._open.pop(entry.agent, None)
        listened = not self.epoch
        heartbeat_due = self._election.tick(now.steady, self._knows_enough(now))
        if not self.epoch:
            return Answers()
        if listened:
            self._journal = self._new_journal(now)
        grants = [grant for entry in self.ledger for grant in self._overdue(entry, now)]
        decided = self._decide_when_due(now)
        return Answers(
            grants + decided.grants,
            decided.steps,
            CoordinatorHeartbeat(self.epoch, self.team) if heartbeat_due else None,
        )

    def end_batch(self, now: ClockReading) -> Answers:
        """Decide for all that have asked, where their time to wait for others is over."""
        return self._decide_when_due(now) if self._decides(now) else Answers()

    def close(self, now: ClockReading) -> Answers:
        """Cut the episode off: say so where it has begun and is not over."""
        return Answers(steps=[self._last_step(now, terminated=False)] if self.epoch and self._journal.open else [])

    def _forget(self, now: ClockReading) -> None:
        super()._forget(now)
        self._journal = self._new_journal(now)
        self._open: dict[str, Request] = {}
        self._repeat_at: dict[str, float] = {}
        self._done: set[str] = set()
        self._batch_at = math.inf

    def _forget_robot(self, agent: str) -> None:
        self._open.pop(agent, None)
        self._done.discard(agent)

    def _new_journal(self, now: ClockReading) -> Journal:
        return Journal(now.task, self._timeouts.time_step, self._discount)

    def _observe(self, request: Request) -> None:
        self._observed[self._places[request.agent]] = request.observation

    def _refuse(self, request: Request, now: ClockReading, refusal: Refusal) -> Answers:
        self.counts[f"refused: {refusal.kind}"] += 1
        answer = Grant(
            stamp=now.stamp,
            agent=request.agent,
            incarnation=request.incarnation,
            request_id=request.request_id,
            coordinator_epoch=self.epoch,
            grant_id=0,
            status=GrantStatus.REFUSED,
            reason=refusal.reason,
            team=self.team,
        )
        return Answers([answer])

    def _credit(self, entry: Entry, request: Request) -> None:
        """Count, once, what the robot's last option brought."""
        if entry.option == NONE:
            return
        longest = self._robots[entry.agent].durations[entry.option]
        if not self._journal.credit(request.option_reward, entry.granted_at, longest):
            self.counts["rewards too large"] += 1

    def _finish(self, entry: Entry, request: Request, now: ClockReading) -> Answers:
        """Note that the task is over for a robot; the last one's word closes the episode."""
        if entry.agent in self._done:
            return self._refuse(request, now, _TASK_OVER)
        if math.isfinite(request.option_reward):
            self._credit(entry, request)
        entry.ask(request.request_id, now.steady)
        entry.end()
        self._open.pop(entry.agent, None)
        self._done.add(entry.agent)
        at_work = any(e.runs or e.state is State.WAITING for e in self.ledger)
        steps = [] if at_work else [self._last_step(now, terminated=True)]
        return Answers(self._refuse(request, now, _TASK_OVER).grants, steps)

    def _believe(self, entry: Entry, status: Status, now: ClockReading) -> None:
        """Acknowledge a grant, or adopt one that this coordinator has not given."""
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
        self._open.pop(entry.agent, None)
        self.counts["adopted grants"] += 1

    def _overdue(self, entry: Entry, now: ClockReading) -> list[Grant]:
        """Return what a robot must be told, or told again."""
        if not entry.runs:
            return []
        duration = self._robots[entry.agent].durations[entry.option]
        if not entry.cancelled and now.task - entry.granted_at > duration:
            entry.cancel()
            self.counts["overruns"] += 1
            self._repeat_at[entry.agent] = now.steady
        unheard = entry.cancelled or entry.phase is State.GRANTED
        if not unheard or now.steady < self._repeat_at.get(entry.agent, now.steady):
            return []
        self._repeat_at[entry.agent] = now.steady + self._timeouts.repeat
        return [self._grant_of(entry, now)]

    def _grant_of(self, entry: Entry, now: ClockReading) -> Grant:
        """Return what stands for a robot's latest request."""
        robot = self._robots[entry.agent]
        return Grant(
            stamp=now.stamp if entry.cancelled else entry.stamp,
            agent=entry.agent,
            incarnation=entry.incarnation,
            request_id=entry.request_id,
            coordinator_epoch=self.epoch if entry.cancelled else entry.epoch,
            grant_id=entry.grant_id,
            status=GrantStatus.CANCELLED if entry.cancelled else GrantStatus.GRANTED,
            reason="it takes longer than it may: ask again" if entry.cancelled else "",
            option=entry.option,
            option_name=robot.agent.options[entry.option],
            deadline=robot.durations[entry.option],
            team=self.team,
        )

    def _all_wait(self) -> bool:
        """Whether every robot that is heard waits: who asks next is nobody."""
        return all(entry.phase in (State.WAITING, State.UNKNOWN) or entry.silence is not None for entry in self.ledger)

    def _decide_when_due(self, now: ClockReading) -> Answers:
        return self._decide(now) if now.steady >= self._batch_at else Answers()

    def _decide(self, now: ClockReading) -> Answers:
        """Decide for all that wait and are heard; who fell silent meanwhile asks again when it returns."""
        self._batch_at = math.inf
        waiting = [name for name in self._open if self.ledger[name].state is State.WAITING]
        asking = {name: self._open.pop(name) for name in sorted(waiting, key=self._index.__getitem__)}
        asked = self._choice(asking)
        choice = query_with_fallback(asked, self._policy, self._timeouts.policy_limit, self._safe_options())
        self.counts.update(choice.faults)
        grants, running = [], asked.running.copy()
        for name, request in asking.items():
            entry, option = self.ledger[name], choice.options[self._index[name]]
            if option < 0:
                entry.end()
                grants += self._refuse(request, now, _NOTHING_SAFE).grants
                continue
            entry.grant(self.epoch, int(option), now.task, now.stamp)
            running[self._index[name]] = option
            self._repeat_at[name] = now.steady + self._timeouts.repeat
            grants.append(self._grant_of(entry, now))
        if all(grant.status is GrantStatus.REFUSED for grant in grants):
            return Answers(grants)
        digest = self.digest if choice.by_policy else ""
        step = self._journal.decision(now, self.epoch, asked, running, choice.log_probability, digest)
        return Answers(grants, [step])

    def _choice(self, asking: Mapping[str, Request]) -> PolicyQuery:
        """Return what the policy is asked."""
        legal, choosing = self._options.copy(), np.zeros(len(self._robots), bool)
        for name, request in asking.items():
            index = self._index[name]
            choosing[index] = True
            if np.size(request.legal):
                legal[index, : np.size(request.legal)] = request.legal
        return PolicyQuery(self._observed.copy(), choosing, self._all_run(), legal)

    def _safe_options(self) -> list[int]:
        return [robot.safe_option for robot in self._robots.values()]

    def _all_run(self) -> JointOptions:
        """Return what each robot carries out now (N,); who waits for an option carries out none."""
        return np.array([entry.option if entry.runs else NONE for entry in self.ledger])

    def _last_step(self, now: ClockReading, terminated: bool) -> JointStep:
        return self._journal.end(now, self.epoch, self._choice({}), self._all_run(), terminated)
