"""Guarantees of a coordinator, tested with one fault at a time."""

from dataclasses import replace

import numpy as np
import pytest
from option_coordinator.policies.policy_query import query_with_fallback
from option_coordinator.protocol.ledger import RobotState, State
from option_coordinator.protocol.protocol_types import AgentState, CoordinatorHeartbeat, GrantStatus
from team import AGENTS, TIMES, at, uniform

from option_coordinator import Coordinator, OptionError, Request, Status

START = 1.0 + TIMES.lost_after  # of robots that have not said anything


def request(agent="r0", request_id=1, now=START, incarnation=7, epoch=0, **changes):
    fields = {"observation": np.zeros(2, np.float32), "legal": np.zeros(0, bool)} | changes
    return Request(now, agent, incarnation, request_id, epoch, **fields)


def running(grant, elapsed=0.0, **changes):
    told = {"coordinator_epoch": grant.coordinator_epoch, "request_id": grant.request_id, "grant_id": grant.grant_id}
    told |= {"incarnation": grant.incarnation, "option": grant.option, "elapsed": elapsed} | changes
    return Status(agent=grant.agent, state=AgentState.RUNNING, **told)


class OneClock:
    """Coordinator with identical, uninterrupted clocks; it ticks five times a second."""

    def __init__(self, *given, **named):
        self.core = Coordinator(*given[:3], at(given[3]), *given[4:], **named)
        self.ticked = given[3]

    def __getattr__(self, name):
        return getattr(self.core, name)

    def _until(self, now):
        while self.ticked + 0.2 < now:
            self.ticked += 0.2
            self.core.tick(at(self.ticked))
        return at(now)

    def tick(self, now):
        out = self.core.tick(self._until(now))
        self.ticked = now
        return out

    def on_request(self, request, now):
        return self.core.on_request(request, self._until(now))

    def on_status(self, status, now):
        return self.core.on_status(status, self._until(now))

    def on_coordinator_heartbeat(self, word, now):
        return self.core.on_coordinator_heartbeat(word, self._until(now))

    def close(self, now):
        return self.core.close(self._until(now))


def coordinator(policy=None, **named):
    out = OneClock(AGENTS, policy or uniform(0), "digest", 0.0, TIMES, seed=0, **named)
    out.tick(START)
    return out


def only(answers):
    (grant,) = answers.grants
    return grant


def test_who_waits_together_is_decided_together():
    team = coordinator()
    first = only(team.on_request(request("r0"), START))
    team.on_status(running(first), START)
    assert not team.on_request(request("r1"), START).grants
    assert not team.on_request(request("r2"), START + 0.005).grants
    answers = team.tick(START + 0.011)
    assert [grant.agent for grant in answers.grants] == ["r1", "r2"]
    (step,) = answers.steps
    assert step.running.tolist() == [True, False, False, False]
    assert step.absent.tolist() == [False, False, False, True]
    assert (step.step, step.policy_digest, step.log_probability) == (1, "digest", -1.0)


def test_a_silent_robot_is_suspect_then_lost_and_attached_again():
    team = coordinator()
    grant = only(team.on_request(request(), START))
    team.on_status(running(grant), START)
    team.tick(START + 0.6)
    assert team.ledger["r0"].state is State.SUSPECT
    team.tick(START + 2.1)
    assert team.ledger["r0"].state is State.LOST
    answers = team.on_request(request("r1", now=START + 2.1), START + 2.1)
    assert answers.steps[0].absent.tolist() == [True, False, True, True]
    assert team.on_status(running(grant, 2.2), START + 2.2).grants == []
    assert team.ledger["r0"].state is State.RUNNING
    assert team.ledger["r0"].grant_id == grant.grant_id


def test_a_new_incarnation_voids_the_old_grant():
    team = coordinator()
    only(team.on_request(request(), START))
    assert team.on_request(request(incarnation=8), START).grants == []  # one wrong message must not end a life
    assert team.counts["second lives"] == 1
    team.tick(START + TIMES.lease)
    fresh = only(team.on_request(request(incarnation=8, now=START + TIMES.lease), START + TIMES.lease))
    assert (fresh.status, fresh.incarnation, fresh.grant_id) == (GrantStatus.GRANTED, 8, 2)
    late = only(team.on_request(request(request_id=2), START + TIMES.lease))
    assert late.status is GrantStatus.REFUSED
    assert "replaced" in late.reason


def test_a_duplicate_gets_the_same_grant_and_a_late_one_a_reason():
    team = coordinator()
    grant = only(team.on_request(request(), START))
    assert only(team.on_request(request(), START + 0.1)) == grant
    only(team.on_request(request(request_id=2), START + 0.2))
    assert only(team.on_request(request(), START + 0.3)).status is GrantStatus.REFUSED


def test_a_stale_epoch_is_refused():
    team = coordinator()
    answer = only(team.on_request(request(epoch=1), START))
    assert answer.status is GrantStatus.REFUSED
    assert "is over" in answer.reason
    assert answer.coordinator_epoch == team.epoch


def test_a_grant_is_repeated_until_acknowledged():
    team = coordinator()
    grant = only(team.on_request(request(), START))
    assert team.tick(START + 0.05).grants == []
    assert team.tick(START + 0.11).grants == [grant]
    team.on_status(running(grant), START + 0.12)
    assert team.tick(START + 0.3).grants == []


def test_an_overrun_cancels_that_robot_alone():
    team = coordinator()
    grants = [only(team.on_request(request("r0"), START))]
    team.on_status(running(grants[0]), START)
    team.on_request(request("r1", now=START + 0.5), START + 0.5)
    grants += team.tick(START + 0.6).grants
    for grant, elapsed in zip(grants, (2.1, 1.5), strict=True):
        team.on_status(running(grant, elapsed), START + 2.1)
    cancelled = only(team.tick(START + 2.11))
    assert (cancelled.agent, cancelled.status) == ("r0", GrantStatus.CANCELLED)
    assert only(team.tick(START + 2.22)).status is GrantStatus.CANCELLED
    team.on_request(request(request_id=2, now=START + 2.3), START + 2.3)
    assert only(team.tick(START + 2.32)).status is GrantStatus.GRANTED


def test_a_restarted_coordinator_adopts_what_runs():
    team = coordinator()
    grant = only(team.on_request(request(), START))
    again = OneClock(AGENTS, uniform(1), "digest", START, TIMES, seed=1)
    again.on_status(running(grant, 0.3), START + 0.3)
    assert again.tick(START + 0.4).grants == []
    for robot in AGENTS[1:]:
        assert not again.tick(START + 0.6).heartbeat  # it may run something
        again.on_status(Status(robot.agent.name, 7, AgentState.WAITING), START + 0.6)
    again.tick(START + 0.6)
    assert again.epoch > team.epoch
    assert again.ledger["r0"].option == grant.option
    assert only(again.on_request(request(), START + 0.6)).grant_id == grant.grant_id
    team.on_coordinator_heartbeat(CoordinatorHeartbeat(again.epoch), START + 0.6)
    assert team.stands_by
    assert team.on_request(request(request_id=2), START + 0.7).grants == []


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"observation": np.full(2, np.nan, np.float32)}, "finite"),
        ({"observation": np.zeros(3, np.float32)}, "shape"),
        ({"legal": np.zeros(2, bool)}, "legal"),
        ({"now": START - 5.0}, "old"),
        ({"agent": "stranger", "team": "delivery"}, "no such robot"),
    ],
)
def test_what_no_policy_may_see_is_refused(changes, reason):
    team = coordinator(team="delivery")
    assert reason in only(team.on_request(request(**changes), START)).reason
    assert sum(n for kind, n in team.counts.items() if kind.startswith("refused")) == 1


def fails(_):
    raise ValueError


@pytest.mark.parametrize(
    ("policy", "fault"),
    [
        (fails, "policy failed: ValueError"),
        (lambda choice: (choice.running, np.nan), "policy not finite"),
        (lambda choice: (choice.running + 9, 0.0), "illegal option"),
        (lambda choice: (choice.running[:1], 0.0), "policy of another size"),
    ],
)
def test_a_policy_that_fails_gives_safe_options(policy, fault):
    team = coordinator(policy)
    answers = team.on_request(request(), START)
    assert only(answers).option == AGENTS[0].safe_option
    assert answers.steps[0].policy_digest == ""
    assert team.counts[fault] == 1
    refused = only(team.on_request(request(request_id=2, legal=np.array([False, True])), START))
    assert refused.status is GrantStatus.REFUSED


def test_a_slow_policy_gives_safe_options():
    team = coordinator()
    chosen = query_with_fallback(team._query.of({"r0": request()}, team.ledger), uniform(0), -1.0, [0, 0, 0, 0])
    assert (chosen.by_policy, chosen.faults) == (False, ["policy too slow"])


def test_the_last_robot_to_end_closes_the_episode():
    team = coordinator()
    team.on_request(request(), START)
    answers = team.on_request(request(request_id=2, terminated=True, option_reward=3.0), START)
    assert answers.steps[0].terminated
    assert answers.steps[0].reward == 3.0


def test_the_ledger_refuses_what_cannot_be():
    entry = RobotState("r0")
    with pytest.raises(OptionError, match=r"heard\(\) first"):
        entry.ask(1, 0.0)
    entry.heard(7, 0.0)
    for method in (entry.acknowledge, entry.cancel, lambda: entry.grant(1, 0, 0.0, 0.0)):
        with pytest.raises(OptionError, match="is idle"):
            method()


def test_a_late_word_of_an_old_life_revives_nothing_unless_the_robot_is_lost():
    entry = RobotState("r0")
    entry.heard(8, 0.0)
    with pytest.raises(OptionError, match="was replaced by 8"):
        entry.heard(7, 0.1)
    assert entry.fall_silent(3.0, TIMES.lease, TIMES.lost_after)
    entry.heard(7, 3.1)
    assert (entry.incarnation, entry.state) == (7, State.IDLE)


def test_a_coordinator_that_hears_another_stands_by_and_knows_who_runs_what_when_it_ends():
    first = coordinator()
    grant = only(first.on_request(request(observation=np.ones(2, np.float32)), START))
    second = OneClock(AGENTS, uniform(1), "digest", START, TIMES, seed=1)
    for tenth in range(30):
        now = START + 0.1 * tenth
        second.on_coordinator_heartbeat(first.tick(now).heartbeat or CoordinatorHeartbeat(first.epoch), now)
        second.on_request(request(now=now, observation=np.ones(2, np.float32)), now)
        second.on_status(running(grant, 0.1 * tenth), now)
        assert (second.tick(now).grants, second.epoch, second.stands_by) == ([], 0, True)
    ended = now
    assert not second.tick(ended + 0.4).heartbeat
    assert second.tick(ended + 0.5).heartbeat == CoordinatorHeartbeat(second.epoch)
    assert second.epoch > first.epoch
    answers = second.on_request(request("r1", now=ended + 0.5), ended + 0.5)
    answers = answers if answers.steps else second.tick(ended + 0.6)
    (step,) = answers.steps
    assert (step.options[0], step.running[0], step.duration) == (grant.option, True, 0)
    assert step.observation[:2].tolist() == [1.0, 1.0]


def test_a_policy_is_replaced_between_decisions():
    team = coordinator()
    team.on_request(request(), START)
    team.replace_policy(uniform(1), "other")
    answers = team.on_request(request(request_id=2), START + 0.1)
    assert answers.steps[0].policy_digest == "other"


def test_discounted_joint_rewards_add_up_to_what_the_options_brought():
    gamma = 0.9
    patient = [replace(robot, durations=(9.0,) * len(robot.durations)) for robot in AGENTS]
    team = OneClock(patient, uniform(0), "", 0.0, TIMES, seed=0, discount=gamma)
    team.tick(START)
    steps = list(team.on_request(request("r0"), START).steps)  # an option from step 0 to 5
    decided = team.on_request(request("r1", now=START + 2), START + 2)  # and one from 2 to 7
    steps += decided.steps
    team.on_status(running(only(decided), 2.98), START + 5)
    team.on_request(request("r0", 2, now=START + 5, option_reward=3.0), START + 5)
    steps += team.tick(START + 5.02).steps
    steps += team.on_request(request("r0", 3, now=START + 6, terminated=True), START + 6).steps
    steps += team.on_request(request("r1", 2, now=START + 7, terminated=True, option_reward=5.0), START + 7).steps
    assert [step.duration for step in steps[1:]] == [2, 3, 2]
    begins = np.cumsum([step.duration for step in steps[1:]]) - [step.duration for step in steps[1:]]
    joint = sum(gamma**begin * step.reward for begin, step in zip(begins, steps[1:], strict=True))
    assert joint == pytest.approx(3.0 + gamma**2 * 5.0)


def test_a_coordinator_that_ends_cuts_off_what_has_begun():
    team = coordinator()
    assert team.close(START).steps == []
    team.on_request(request(), START)
    (step,) = team.close(START + 1.0).steps
    assert (step.truncated, step.terminated, step.running[0], step.duration) == (True, False, True, 1)
    assert team.close(START + 1.0).steps == []
