"""Robot side of the protocol, step by step; `test_coordination_events` runs it against coordinators."""

from dataclasses import replace

import numpy as np
import pytest
from option_coordinator.protocol.protocol_types import AgentState, GrantStatus
from option_coordinator.protocol.work_memory import WorkMemory
from team import at

from option_coordinator import (
    AgentObservation,
    ClientTimeouts,
    Grant,
    OptionClient,
    OptionError,
    OptionResult,
    Request,
    TeamId,
)


class Log:
    """Option executor that only records its calls."""

    def __init__(self):
        self.told = []

    def observe(self):
        return AgentObservation(np.zeros(2), np.ones(3, bool))

    def begin(self, option):
        self.told.append(option)

    def leave(self):
        self.told.append("leave")
        return OptionResult(2.0, 4)


@pytest.fixture
def robot():
    client = OptionClient(
        "r0", ("a", "b", "c"), Log(), incarnation=7, safe_option=2, timeouts=ClientTimeouts(0.1, 0.1, 1.0)
    )
    client.ask(at(0.0))
    return client


def granted(request_id=1, epoch=5, option=1, grant_id=1, status=GrantStatus.GRANTED, deadline=3.0):
    return Grant(0.0, "r0", 7, request_id, epoch, grant_id, status, "", option, "", deadline)


def requests(words):
    return [word for word in words if isinstance(word, Request)]


def told(robot):
    return robot._executor.told


def test_a_request_is_repeated_until_it_is_answered(robot):
    assert [len(requests(robot.due_messages(at(now)))) for now in (0.0, 0.05, 0.1, 0.2)] == [1, 0, 1, 1]
    robot.on_grant(granted(), at(0.2))
    (status,) = robot.due_messages(at(0.2))
    assert (status.state, status.grant_id, status.coordinator_epoch) == (AgentState.RUNNING, 1, 5)
    assert not requests(robot.due_messages(at(0.5)))


def test_a_grant_is_carried_out_once_however_often_it_is_heard(robot):
    for _ in range(3):
        robot.on_grant(granted(), at(0.1))
    assert told(robot) == [1]


@pytest.mark.parametrize("change", [{"agent": "r1"}, {"incarnation": 6}, {"request_id": 2}, {"option": 3}])
def test_what_is_meant_for_others_means_nothing(robot, change):
    robot.on_grant(replace(granted(), **change), at(0.1))
    assert told(robot) == []
    assert robot.state is AgentState.WAITING


def test_a_lower_epoch_means_nothing(robot):
    robot.on_grant(granted(), at(0.1))
    robot.on_grant(granted(epoch=4, status=GrantStatus.CANCELLED), at(0.2))
    assert robot.state is AgentState.RUNNING
    assert robot.counts["lower epochs"] == 1


def test_cancelled_it_leaves_the_option_and_asks_under_a_new_number(robot):
    robot.on_grant(granted(), at(0.1))
    robot.on_grant(granted(status=GrantStatus.CANCELLED), at(0.2))
    (request,) = requests(robot.due_messages(at(0.2)))
    assert (request.request_id, request.option_reward, request.option_duration) == (2, 2.0, 4)
    assert told(robot) == [1, "leave"]


def test_at_its_deadline_it_asks_and_has_its_safe_option_until_a_grant_comes(robot):
    robot.on_grant(granted(), at(0.1))
    robot.tick(at(3.0))
    assert told(robot) == [1]
    robot.tick(at(3.2))
    assert (robot.state, told(robot)) == (AgentState.FALLBACK, [1, "leave", 2])
    assert [request.request_id for request in requests(robot.due_messages(at(3.2)))] == [2]
    robot.ended(at(3.3))  # the safe option may end by itself: nobody granted it
    robot.on_grant(granted(request_id=2, grant_id=2, option=0), at(3.4))
    assert told(robot) == [1, "leave", 2, "leave", 0]


def test_without_an_answer_it_has_its_safe_option(robot):
    robot.tick(at(0.9))
    assert told(robot) == []
    robot.tick(at(1.1))
    assert (robot.state, told(robot)) == (AgentState.FALLBACK, [2])


def test_refused_for_its_epoch_it_repeats_the_request_at_once(robot):
    robot.due_messages(at(0.0))
    robot.on_grant(granted(status=GrantStatus.REFUSED), at(0.01))
    (request,) = requests(robot.due_messages(at(0.01)))
    assert (request.request_id, request.coordinator_epoch) == (1, 5)


def test_refused_for_anything_else_it_observes_again_and_takes_its_time(robot):
    robot.on_grant(granted(request_id=9), at(0.0))
    robot.due_messages(at(0.0))
    robot.on_grant(granted(status=GrantStatus.REFUSED), at(0.01))
    assert not requests(robot.due_messages(at(0.05)))
    (request,) = requests(robot.due_messages(at(0.2)))
    assert (request.request_id, request.stamp) == (2, 0.01)
    robot.tick(at(1.1))
    assert robot.state is AgentState.FALLBACK


def test_its_last_word_is_repeated_until_it_is_heard(robot):
    robot.on_grant(granted(), at(0.1))
    robot.ended(at(0.2), OptionResult(1.0, 2), terminated=True)
    robot.tick(at(5.0))
    (request,) = requests(robot.due_messages(at(5.0)))
    assert request.terminated
    assert not robot.finished
    robot.on_grant(granted(request_id=2, status=GrantStatus.REFUSED), at(5.1))
    assert (robot.finished, robot.state) == (True, AgentState.IDLE)
    assert not requests(robot.due_messages(at(6.0)))


@pytest.mark.fault
def test_a_grant_of_another_option_name_or_team_file_is_ignored_and_said():
    client = OptionClient("r0", ("a", "b", "c"), Log(), incarnation=7, team=TeamId("t", "mine"))
    client.ask(at(0.0))
    client.on_grant(replace(granted(), option_name="a"), at(0.1))
    assert client.problem == "option 1 is 'a' for the coordinator and 'b' here: give both the same options"
    client.on_grant(replace(granted(), team="t", team_digest="other"), at(0.1))
    assert client.problem.startswith("the coordinator's team file differs (digest other, this robot's mine)")
    assert told(client) == []
    assert (client.counts["grants of other options"], client.counts["grants of another team file"]) == (1, 1)
    client.on_grant(replace(granted(), team="t", team_digest="mine", option_name="b"), at(0.2))
    assert (told(client), client.problem) == ([1], "")


@pytest.mark.fault
def test_the_reason_of_a_refusal_and_of_a_cancellation_is_kept(robot):
    robot.on_grant(granted(request_id=9), at(0.0))
    robot.due_messages(at(0.0))
    robot.on_grant(replace(granted(status=GrantStatus.REFUSED), reason="too old"), at(0.01))
    assert robot.problem == "refused: too old"
    robot.on_grant(granted(request_id=2), at(0.2))
    assert robot.problem == ""
    robot.on_grant(replace(granted(2, status=GrantStatus.CANCELLED), option_name="b", reason="too long"), at(0.3))
    assert robot.problem == "'b' was cancelled: too long"


class Carrier(Log):
    """Executor with work that outlives it."""

    work = "empty"

    def observe(self):
        return AgentObservation(np.zeros(2), np.ones(3, bool), self.work)

    def resume(self, work):
        if work == "nonsense":
            raise OptionError("not its work")
        self.work = work


@pytest.mark.fault
def test_a_restarted_robot_takes_over_its_kept_work_before_it_tells_its_own():
    client = OptionClient("r0", ("a", "b", "c"), Carrier(), incarnation=7)
    client.ask(at(0.0))
    assert requests(client.due_messages(at(0.0)))[0].work == ""
    client.on_grant(replace(granted(epoch=0, status=GrantStatus.REFUSED), reason="kept", work="a parcel"), at(0.1))
    (request,) = requests(client.due_messages(at(0.3)))
    assert (request.request_id, request.work, client.problem) == (2, "a parcel", "")
    client.on_grant(granted(request_id=2), at(0.4))
    client.on_grant(replace(granted(2, status=GrantStatus.CANCELLED), work="old"), at(0.5))
    assert requests(client.due_messages(at(0.6)))[0].work == "a parcel"


@pytest.mark.fault
def test_a_robot_with_a_file_knows_its_work_until_its_task_is_over(tmp_path):
    def started():
        client = OptionClient("r0", ("a", "b", "c"), Carrier(), 7, memory=WorkMemory(tmp_path / "work", "t"))
        client.ask(at(0.0))
        return client, requests(client.due_messages(at(0.0)))[0].work

    client, work = started()
    assert work == ""
    client.on_grant(granted(), at(0.1))
    client._executor.work = "a parcel"
    client.ended(at(0.2))
    client, work = started()
    assert work == "a parcel"
    client.on_grant(granted(), at(0.1))
    client.ended(at(0.2), terminated=True)
    client.on_grant(granted(2, status=GrantStatus.REFUSED), at(0.3))
    assert started()[1] == ""


@pytest.mark.fault
def test_kept_work_that_is_none_is_said_and_not_taken_over():
    client = OptionClient("r0", ("a", "b", "c"), Carrier(), incarnation=7)
    client.ask(at(0.0))
    client.on_grant(replace(granted(epoch=0, status=GrantStatus.REFUSED), work="nonsense"), at(0.1))
    assert client.problem == "there is kept work that this robot cannot take over: 'nonsense'"
    assert requests(client.due_messages(at(0.3)))[0].work == ""
