"""Wrong and hostile messages have no lasting effect on coordinators and robots; real messages and protocol."""

import math
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from option_coordinator.nodes.messages import StepMessages, grant_message, grant_of, heartbeat_of, request_of, status_of
from option_coordinator.protocol.clock_reading import TaskTime
from option_coordinator.protocol.election import Epochs
from option_coordinator.protocol.grants import EpisodeRecorder
from option_coordinator.protocol.protocol_types import AgentState, CoordinatorHeartbeat, GrantStatus, MessageError
from team import AGENTS, STEP, TIMES, SimulatedCoordinator, Team, at

from ctrl_rl_msgs.msg import AgentStatus, CoordinatorStatus, OptionGrant, OptionRequest
from option_coordinator import Grant, Request, Status, TeamId

pytestmark = pytest.mark.fault

UINT64 = st.one_of(
    st.integers(0, 3000), st.sampled_from([2**61, 2**62 - 1, 2**63, 2**64 - 1]), st.integers(0, 2**64 - 1)
)
FLOAT = st.one_of(st.floats(width=64), st.sampled_from([math.nan, math.inf, -math.inf, -1e308, 1e4, 1e6]))
NAME = st.one_of(st.sampled_from([*(robot.agent.name for robot in AGENTS), "", "stranger"]), st.text(max_size=300))
TEAM = st.sampled_from(["", "other", "x" * 300])
LEGAL = st.one_of(st.lists(st.booleans(), max_size=4), st.just([True] * 10001))
OBSERVATION = st.lists(st.floats(width=32), max_size=3)
STEP_MESSAGE = StepMessages(tuple(robot.agent for robot in AGENTS), 0.99, TIMES.time_step)


@st.composite
def requests(draw):
    out = OptionRequest(
        agent=draw(NAME),
        incarnation=draw(UINT64),
        request_id=draw(UINT64),
        coordinator_epoch=draw(UINT64),
        observation=draw(OBSERVATION),
        legal=draw(LEGAL),
        option_reward=draw(FLOAT),
        option_duration=draw(st.integers(0, 2**32 - 1)),
        terminated=draw(st.booleans()),
        team=draw(TEAM),
    )
    out.header.stamp.sec, out.header.stamp.nanosec = (
        draw(st.integers(-(2**31), 2**31 - 1)),
        draw(st.integers(0, 2**32 - 1)),
    )
    return out


@st.composite
def statuses(draw):
    return AgentStatus(
        agent=draw(NAME),
        incarnation=draw(UINT64),
        state=draw(st.integers(0, 255)),
        coordinator_epoch=draw(UINT64),
        request_id=draw(UINT64),
        grant_id=draw(UINT64),
        option=draw(st.integers(0, 2**32 - 1)),
        elapsed=draw(FLOAT),
        team=draw(TEAM),
    )


@st.composite
def grants(draw):
    return OptionGrant(
        agent=draw(NAME),
        incarnation=draw(UINT64),
        request_id=draw(UINT64),
        coordinator_epoch=draw(UINT64),
        grant_id=draw(UINT64),
        status=draw(st.integers(0, 255)),
        option=draw(st.integers(0, 2**32 - 1)),
        deadline=draw(FLOAT),
        team=draw(TEAM),
    )


@st.composite
def words(draw):
    return CoordinatorStatus(coordinator_epoch=draw(UINT64), team=draw(TEAM))


READERS = {OptionRequest: request_of, AgentStatus: status_of, OptionGrant: grant_of, CoordinatorStatus: heartbeat_of}


def taken(message):
    """Content of a message, or None if its sender is not authorised; the reason repeats nothing from the message."""
    try:
        return READERS[type(message)](message)
    except MessageError as error:
        reason = str(error)
    assert len(reason) < 60
    return None


@settings(max_examples=300, deadline=None, derandomize=True)
@given(message=st.one_of(requests(), statuses(), grants(), words()))
def test_what_passes_the_door_is_in_range_and_what_does_not_says_why(message):
    told = taken(message)
    assert getattr(told, "coordinator_epoch", 0) < 2**62
    assert getattr(told, "request_id", 0) < 2**62
    assert getattr(told, "grant_id", 0) < 2**62
    assert 0.0 <= getattr(told, "elapsed", 0.0) <= 1e7
    assert 0.0 <= getattr(told, "deadline", 0.0) <= 1e7
    assert len(getattr(told, "agent", "")) <= 255


@pytest.mark.parametrize("elapsed", [math.nan, math.inf, -math.inf, -1e308, -1.0, 1e8])
def test_an_impossible_elapsed_does_not_pass(elapsed):
    with pytest.raises(MessageError, match="elapsed out of range"):
        status_of(AgentStatus(agent="r0", incarnation=1, elapsed=elapsed))


def test_what_a_robot_says_of_the_past_does_not_blow_up_the_joint_reward():
    team = Team(0)
    team.advance(1.0)
    core, robot = team.coordinators[0].core, team.robots["r0"].client
    told = {"coordinator_epoch": core.epoch, "request_id": robot.request_id, "grant_id": 99, "option": 1}
    core.on_status(Status("r0", robot.incarnation, AgentState.RUNNING, elapsed=1e6, **told), at(team.now))
    request = Request(
        team.now, "r0", robot.incarnation, robot.request_id + 1, 0, np.zeros(2, np.float32), np.zeros(0, bool), 1.0
    )
    answers = core.on_request(request, at(team.now))
    steps = answers.steps or core.tick(at(team.now + 0.02)).steps
    assert all(abs(step.reward) <= 1.01 for step in steps)
    assert not core.tick(at(team.now + 1e-3)).steps or all(math.isfinite(step.reward) for step in steps)


@pytest.mark.parametrize("began", [-1e4, -1e300, 0.0])
def test_a_reward_is_counted_from_its_options_longest_duration_at_most(began):
    journal = EpisodeRecorder(0.0, 1.0, 0.99)
    assert journal.credit(1.0, began, 60.0)
    assert journal._reward <= 0.99**-60
    assert not EpisodeRecorder(0.0, 1e-3, 0.5).credit(1.0, -1e6, 1e6)  # overflows: not counted


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 99), hail=st.lists(st.one_of(requests(), statuses(), grants(), words()), max_size=60))
def test_a_hail_of_messages_ends_nothing_and_once_it_is_over_all_are_served(seed, hail):
    team = Team(seed)
    team.start_coordinator()
    team.advance(1.5)
    for message in hail:
        team.advance(STEP)
        told = taken(message)
        if told is not None:
            strike(team, told)
    team.advance(2 * TIMES.lost_after)  # what was said in a robot's name is contradicted by then
    team.settle()


def strike(team, told):
    """Deliver a message to all participants; their replies are sent as usual."""
    for coordinator in team.coordinators:
        if not isinstance(told, Grant):
            answers = coordinator.take(told, team.now)
            for step in answers.steps:
                assert math.isfinite(STEP_MESSAGE(step).reward)
            for grant in answers.grants:
                assert len(grant_message(grant).reason) <= 500
    for robot in team.robots.values():
        if isinstance(told, Grant | CoordinatorHeartbeat) and robot.alive:
            robot.inbox.append(told)


def of_robot(robots, name, **changes):
    """Status in the name of a live robot."""
    return replace(robots.robots[name].client._status(at(robots.now)), **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"request_id": 2**62 - 1, "state": AgentState.RUNNING, "grant_id": 2**62 - 1},
        {"request_id": 500, "state": AgentState.RUNNING, "grant_id": 5},
        {"incarnation": 2**63 - 1},
        {"coordinator_epoch": 2**62 - 1},
        {"coordinator_epoch": 2**61 - 1, "incarnation": 2**62},
    ],
)
def test_one_wrong_word_in_a_robots_name_does_not_lock_it_out(changes):
    team = Team(3)
    team.advance(1.5)
    strike(team, of_robot(team, "r0", **changes))
    team.advance(2 * TIMES.lost_after)
    team.settle()


@pytest.mark.parametrize("request_id", [2**62 - 1, 1000])
def test_one_request_with_a_leaping_number_does_not_lock_a_robot_out(request_id):
    team = Team(4)
    team.advance(1.5)
    client = team.robots["r0"].client
    told = Request(team.now, "r0", client.incarnation, request_id, 0, np.zeros(2, np.float32), np.zeros(0, bool))
    strike(team, told)
    team.advance(2 * TIMES.lost_after)
    team.settle()


def test_words_and_messages_of_another_team_mean_nothing():
    team = Team(5)
    team.advance(1.5)
    (core,) = (coordinator.core for coordinator in team.coordinators)
    core.team = TeamId("mine")
    before = core.epoch
    for k in range(1, 100):
        strike(team, CoordinatorHeartbeat(before + (k << 32), "other"))
        strike(team, of_robot(team, "r0", coordinator_epoch=before + (k << 32), team="other"))
        team.advance(STEP)
    assert core.epoch == before
    assert core.counts["stepped down"] == 0


@settings(max_examples=100, deadline=None, derandomize=True)
@given(epochs=st.lists(st.integers(0, 2**64 - 1), max_size=200))
def test_epochs_that_leap_do_not_move_who_believes_one(epochs):
    seen = Epochs(0.5)
    seen.believe(7 << 32, 0.0)
    for number, epoch in enumerate(dict.fromkeys(epochs)):
        seen.believe(epoch, 0.01 * number)
    assert seen.highest <= (7 << 32) + sum(epoch <= (16 * 200) << 32 for epoch in epochs) * (16 << 32)


def test_a_real_leap_is_believed_once_it_has_lasted():
    seen = Epochs(0.5)
    seen.believe(7 << 32, 0.0)
    assert [seen.believe(9999 << 32, 0.1 * k) for k in range(7)] == [False] * 5 + [True] * 2


def test_time_in_the_robots_world_does_not_follow_a_clock_that_is_set():
    passed = TaskTime()
    walls = np.arange(0.0, 10.0, 0.1)
    for wall in walls:
        jump = 72_000.0 if wall > 3.0 else 0.0
        simulated = passed(5.0 + 2.0 * wall + jump - (80_000.0 if wall > 6.0 else 0.0), wall, simulated=True)
    assert simulated == pytest.approx(2.0 * walls[-1] - 0.4)  # nothing passes where it is set
    assert passed.jumps == 2
    free = TaskTime()
    for wall in walls:
        real = free(1e9 + wall + (-3600.0 if wall > 5.0 else 0.0), wall, simulated=False)
    assert (real, free.jumps) == (pytest.approx(walls[-1]), 1)


def test_who_was_frozen_hears_what_happened_before_it_decides():
    """On resuming, it holds a robot's request but not yet the message of the coordinator that took over."""
    team = Team(6)
    team.advance(1.5)
    frozen = team.coordinators[0]
    old = frozen.core.epoch
    team.start_coordinator()
    team.advance(0.5)
    for lease in (1.5, 30.0):
        frozen.frozen = True
        team.advance(lease * TIMES.lease)
        frozen.inbox.clear()
        client = team.robots["r0"].client
        now = at(team.now)
        request = Request(
            now.stamp, "r0", client.incarnation, client.request_id, 0, np.zeros(2, np.float32), np.zeros(0, bool)
        )
        assert frozen.core.on_request(request, now) == frozen.core.tick(now)
        assert not frozen.core.tick(now).grants
        assert not frozen.core.tick(now).heartbeat
        frozen.frozen = False
        team.advance(2.0)
        assert frozen.core.epoch != old or not frozen.core.epoch


def test_a_request_of_a_higher_epoch_is_not_granted_in_a_lower_one():
    team = Team(8)
    team.advance(1.5)
    core, client = team.coordinators[0].core, team.robots["r0"].client
    above = core.epoch + (1 << 32)
    seen, legal = np.zeros(2, np.float32), np.zeros(0, bool)
    request = Request(team.now, "r0", client.incarnation, client.request_id + 1, above, seen, legal)
    assert core.on_request(request, at(team.now)).grants == []
    assert core.counts["requests of higher epochs"] == 1


@pytest.mark.parametrize(("leases", "same_epoch"), [(0.6, True), (0.9, False), (3.0, False)])
def test_a_thawed_coordinator_that_nobody_has_replaced_goes_on_with_what_it_knows(leases, same_epoch):
    team = Team(7)
    team.advance(1.5)
    alone = team.coordinators[0]
    old, ledger = alone.core.epoch, alone.core.ledger
    alone.frozen = True
    team.advance(leases * TIMES.lease)
    alone.frozen = False
    team.advance(1.0 + TIMES.lease)
    assert (alone.core.epoch == old) is same_epoch
    assert alone.core.epoch >= old
    assert alone.core.ledger is ledger
    team.settle()


def test_a_refusal_repeats_nothing_of_the_request():
    team = SimulatedCoordinator(0.0, 0)
    for tick in range(200):
        team.core.tick(at(0.02 * tick))
    legal = np.ones(10_000, bool)
    request = Request(4.0, "r0", 1, 1, 0, np.zeros(2, np.float32), legal)
    (grant,) = team.core.on_request(request, at(3.98)).grants
    assert grant.status is GrantStatus.REFUSED
    assert len(grant.reason) < 120
    with pytest.raises(MessageError, match="legal options too long"):
        request_of(OptionRequest(agent="r0", incarnation=1, request_id=1, legal=[True] * 10_001))
