"""Guarantees of the coordinator with real processes: killed, frozen, duplicated, delayed, restarted, replaced."""

import itertools
import os
import signal
from collections import Counter

import numpy as np
import pytest
from option_coordinator.nodes.messages import grant_message
from option_coordinator.protocol.protocol_types import AgentState, GrantStatus
from rig import LOST_AFTER, write_policy

from option_coordinator import Grant

pytestmark = pytest.mark.timeout(900)  # waits end by themselves, see `PATIENCE`


def no_double_grants(rig):
    """Check that each request in a robot's life gets one grant per epoch, however often it is sent."""
    answers = {}
    for grant in rig.grants:
        if grant.status is GrantStatus.GRANTED:
            request = (grant.coordinator_epoch, grant.agent, grant.incarnation, grant.request_id)
            answers.setdefault(request, set()).add((grant.grant_id, grant.option))
    assert answers
    assert all(len(found) == 1 for found in answers.values())


def test_a_dead_robot_leaves_the_team_and_nobody_waits_for_it(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.0)
    rig.robot("r1", lasts=0.1)
    rig.new_step(lambda s: s.running[0] and s.options[1] >= 0, "both work")
    rig.kill("r0")
    step = rig.new_step(lambda s: s.absent[0], "the dead one is absent")
    assert step.options[0] == -1
    assert not step.running[0]
    rig.granted("r1", len(rig.given("r1")) + 3)
    no_double_grants(rig)


def test_a_frozen_robot_returns_to_its_own_grant(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.0)
    rig.robot("r1", lasts=0.1)
    rig.until(lambda: rig.running("r0"), "it works")
    grant = rig.granted("r0")
    rig.signal("r0", signal.SIGSTOP)
    rig.new_step(lambda s: s.absent[0], "the frozen one is absent")
    rig.signal("r0", signal.SIGCONT)
    step = rig.new_step(lambda s: s.running[0], "it is counted on again")
    assert step.options[0] == grant.option
    assert {g.grant_id for g in rig.given("r0")} == {grant.grant_id}


def test_a_new_life_voids_the_old_grant(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.0)
    old = rig.granted("r0")
    rig.kill("r0")
    rig.robot("r0", lasts=0.0)
    new = rig.granted("r0", 2)
    assert new.incarnation > old.incarnation
    assert new.grant_id > old.grant_id
    late = rig.answer(lambda g: g.incarnation == old.incarnation and g.reason, "late", incarnation=old.incarnation)
    assert (late.status, "was replaced" in late.reason) == (GrantStatus.REFUSED, True)


def test_an_option_that_takes_too_long_is_cancelled_for_that_robot_alone(rig):
    rig.coordinator(longest_option=1.0)
    rig.robot("r0", lasts=0.0)
    rig.robot("r1", lasts=0.2)
    rig.granted("r0", 2)
    # A robot ends it by its own deadline, or at the coordinator's word, whichever comes first.
    assert len(rig.given("r0", GrantStatus.CANCELLED)) <= len(rig.given("r0"))
    assert not rig.given("r1", GrantStatus.CANCELLED)
    no_double_grants(rig)


def test_the_coordinator_cancels_a_robot_that_does_not_watch_its_deadline(rig):
    rig.coordinator(longest_option=0.3)
    grant = rig.answer(lambda g: g.status is GrantStatus.GRANTED, "a grant")

    def cancelled():
        told = {"coordinator_epoch": grant.coordinator_epoch, "request_id": 1, "grant_id": grant.grant_id}
        rig.say(AgentState.RUNNING, option=grant.option, elapsed=0.5, **told)
        return rig.given("r0", GrantStatus.CANCELLED)

    (first,) = rig.until(cancelled, "it is called off")
    assert first.grant_id == grant.grant_id
    again = rig.answer(lambda g: g.status is GrantStatus.GRANTED and g.request_id == 2, "another", request_id=2)
    assert again.grant_id == grant.grant_id + 1


def test_two_that_wait_for_each_other_for_ever_are_freed(rig):
    rig.coordinator(longest_option=0.5)
    for name in ("r0", "r1"):
        rig.robot(name, lasts=0.0)
    for name in ("r0", "r1"):
        rig.granted(name, 3)


def test_a_duplicate_gets_the_same_grant_and_a_late_request_a_reason(rig):
    rig.coordinator()
    first = rig.answer(lambda g: g.status is GrantStatus.GRANTED, "a grant", request_id=2)
    for _ in range(20):
        rig.ask(request_id=2)
    rig.until(lambda: rig.counted("duplicate requests") >= 20, "duplicates are counted")
    late = rig.answer(lambda g: g.request_id == 1, "an answer to the late one", request_id=1)
    assert (late.status, "has been sent since" in late.reason) == (GrantStatus.REFUSED, True)
    assert {(g.grant_id, g.option) for g in rig.given("r0")} == {(first.grant_id, first.option)}


def test_a_stale_epoch_is_refused_with_a_reason(rig):
    rig.coordinator()
    rig.answer(lambda g: g.status is GrantStatus.GRANTED, "a grant")
    answer = rig.answer(lambda g: g.request_id == 2, "an answer", request_id=2, epoch=1)
    assert (answer.status, "is over" in answer.reason) == (GrantStatus.REFUSED, True)


def test_a_grant_is_repeated_until_it_is_acknowledged(rig):
    rig.coordinator()
    grant = rig.answer(lambda g: g.status is GrantStatus.GRANTED, "a grant")

    def repeated():
        rig.say(AgentState.WAITING, request_id=1)
        return Counter(g.grant_id for g in rig.grants)[grant.grant_id] >= 5

    rig.until(repeated, "it is repeated")
    told = {"coordinator_epoch": grant.coordinator_epoch, "request_id": 1, "grant_id": grant.grant_id}
    rig.say(AgentState.RUNNING, option=grant.option, elapsed=0.0, **told)
    rig.let_pass(0.3)
    before = len(rig.grants)
    rig.let_pass(0.3)
    assert len(rig.grants) <= before + 1  # one may have been under way


def test_without_a_coordinator_a_robot_has_its_safe_option(rig):
    rig.robot("r0", patience=0.3)
    rig.until(lambda: any(s.state == AgentState.FALLBACK for s in rig.statuses), "it falls back")
    rig.coordinator()
    rig.granted("r0", 2)
    no_double_grants(rig)


def test_a_killed_coordinator_is_replaced_by_one_that_knows_who_runs_what(rig):
    patient = {"lost_after": 60.0}  # however late the middleware lets them find each other
    rig.coordinator(**patient)
    rig.robot("r0", lasts=0.0)
    rig.robot("r1", lasts=0.2)
    held = rig.granted("r0")
    rig.until(lambda: rig.running("r0") and len(rig.given("r1")) > 1, "both work")
    rig.kill("coordinator")
    rig.until(lambda: not rig.running("r1"), "the other one ends its option by itself")
    assert rig.running("r0")
    rig.coordinator(**patient)
    step = rig.new_step(lambda s: s.coordinator_epoch > held.coordinator_epoch and s.options[1] >= 0, "it decides")
    assert step.running[0]
    assert step.options[0] == held.option
    rig.until(lambda: rig.given("r1")[-1].coordinator_epoch == step.coordinator_epoch, "the other one goes on")
    assert len(rig.given("r0")) == 1
    no_double_grants(rig)


def test_a_frozen_coordinator_goes_on(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.1, patience=0.3)
    rig.granted("r0", 2)
    rig.signal("coordinator", signal.SIGSTOP)
    rig.until(lambda: rig.says("r0", AgentState.FALLBACK), "the robot helps itself")
    rig.let_pass(LOST_AFTER)
    rig.signal("coordinator", signal.SIGCONT)
    rig.granted("r0", len(rig.given("r0")) + 3)
    no_double_grants(rig)


def one_decides(rig, *names):
    """Wait until exactly one coordinator decides and remains alone for several leases; return its name and epoch."""
    robots = ("r0", "r1")

    def rounds():
        seen = len(rig.grants)
        for robot in robots:
            rig.granted(robot, len(rig.given(robot)) + 10)
        epochs = {grant.coordinator_epoch for grant in rig.grants[seen:]}
        return epochs if len(epochs) == 1 else None

    (epoch,) = rig.until(rounds, "grants of one epoch")
    name = rig.until(lambda: rig.deciding(*names), "one decides")
    return name, epoch


def test_of_several_coordinators_one_decides_and_is_replaced_when_it_dies(rig):
    names = ["first", "second", "third"]
    rig.coordinator("first", "second")  # at once
    rig.coordinator("third")
    rig.robot("r0", lasts=0.1)
    rig.robot("r1", lasts=0.1)
    before = 0
    while names:
        name, epoch = one_decides(rig, *names)
        assert epoch > before
        before = epoch
        rig.kill(name)
        names.remove(name)
    no_double_grants(rig)


def test_robots_ignore_a_lower_epoch(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.0)
    running = rig.until(lambda: rig.running("r0"), "it works")
    low = Grant(0.0, "r0", running.incarnation, running.request_id, 1, running.grant_id, GrantStatus.CANCELLED)

    def ignored():
        rig.grant_publisher.publish(grant_message(low))
        return rig.counted("lower epochs", "r0") > 0

    rig.until(ignored, "it is ignored")
    assert rig.running("r0").grant_id == running.grant_id


@pytest.mark.parametrize(("broken", "kind"), [("number", "refused: not finite"), ("size", "refused: wrong size")])
def test_what_no_policy_may_see_is_refused_counted_and_said(rig, broken, kind):
    rig.coordinator()
    rig.robot("r0", broken=broken, patience=0.3)
    rig.robot("r1", lasts=0.1)
    rig.until(lambda: rig.counted(kind) > 0, "it is counted")
    rig.until(lambda: any(s.agent == "r0" and s.state == AgentState.FALLBACK for s in rig.statuses), "it helps itself")
    rig.granted("r1", 3)
    assert not rig.given("r0")
    assert all(np.isfinite(step.observations).all() for step in rig.steps)


def test_a_stale_observation_is_refused(rig):
    rig.coordinator(stale=1.0)
    answer = rig.answer(lambda g: g.status is GrantStatus.REFUSED, "an answer", stamp=1.0)
    assert "observe and ask again" in answer.reason


def test_a_policy_that_is_too_slow_gives_safe_options(rig):
    rig.coordinator(policy_limit=0.00001)  # too short for any policy

    numbers = itertools.count(1)

    def slow():
        rig.ask("r0", request_id=next(numbers))
        rig.let_pass(0.2)
        return rig.counted("policy too slow") > 0

    rig.until(slow, "it is counted")
    assert any(step.policy_digest == "" for step in rig.steps)


def test_a_policy_is_replaced_between_decisions_and_only_by_what_was_promised(rig, tmp_path):
    rig.coordinator()
    rig.robot("r0", lasts=0.05)
    rig.new_step(lambda s: s.policy_digest == rig.digest, "the first decides")
    other, strangers = tmp_path / "other.safetensors", tmp_path / "strangers.safetensors"
    digest = write_policy(other, seed=1)
    write_policy(strangers, robots=3)
    assert rig.set_parameter("policy_digest", "0" * 64).successful
    refused = rig.set_parameter("policy", str(other))
    assert (refused.successful, "its digest is" in refused.reason) == (False, True)
    assert rig.set_parameter("policy_digest", "").successful
    refused = rig.set_parameter("policy", str(strangers))
    assert (refused.successful, "other robots or options" in refused.reason) == (False, True)
    rig.new_step(lambda s: s.policy_digest == rig.digest, "the first goes on")
    assert rig.set_parameter("policy", str(other)).successful
    rig.new_step(lambda s: s.policy_digest == digest, "the other decides")
    assert {step.policy_digest for step in rig.steps} == {rig.digest, digest}


def test_a_coordinator_that_ends_closes_its_episode(rig):
    rig.coordinator()
    rig.robot("r0", lasts=0.1)
    rig.granted("r0", 2)
    process = rig.processes.pop("coordinator")
    os.kill(process.pid, signal.SIGTERM)
    rig.until(lambda: any(step.truncated for step in rig.steps), "the closing word")
    process.join(120.0)
    assert process.exitcode == 0


@pytest.mark.slow
def test_ten_thousand_options_with_random_kills_freezes_and_restarts(rig):
    random = np.random.default_rng(0)
    write_policy(rig.policy, robots=4)
    robots = [f"r{i}" for i in range(4)]
    rig.coordinator()
    for name in robots:
        rig.robot(name, lasts=0.01)
    while sum(len(rig.given(robot)) for robot in robots) < 10_000:
        rig.granted(robots[0], len(rig.given(robots[0])) + 50)
        name = str(random.choice([*robots, "coordinator"]))
        pause = random.uniform(0.0, 2 * LOST_AFTER)
        if random.random() < 0.5:
            rig.kill(name)
            rig.let_pass(pause)
            rig.coordinator() if name == "coordinator" else rig.robot(name, lasts=0.01)
        else:
            rig.signal(name, signal.SIGSTOP)
            rig.let_pass(pause)
            rig.signal(name, signal.SIGCONT)
        for robot in robots:
            rig.granted(robot, len(rig.given(robot)) + 1)
    no_double_grants(rig)
    assert len({grant.coordinator_epoch for grant in rig.grants}) > 1
