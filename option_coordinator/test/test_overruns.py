"""An option that overruns is not granted for ever, and a run without an end gets a verdict."""

import numpy as np
import pytest
from option_coordinator.protocol.overruns import OverrunLimit
from option_coordinator.protocol.protocol_types import GrantStatus
from team import TIMES, uniform
from test_coordination import START, OneClock, request, running

from option_coordinator import Agent, CoordinatorTimeouts, RobotSpec

pytestmark = pytest.mark.fault
AGENT = Agent("r0", ("wait", "go", "look"), 2)
WAIT, GO, LOOK = range(3)


def end(limit, option, overran):
    limit.began("r0", option, 10.0)
    limit.ended("r0", option, 70.0 if overran else 30.0, 60.0)


def allowed(limit, legal=()):
    return np.flatnonzero(limit.allowed(AGENT, np.array(legal, bool))).tolist()


def test_an_option_that_just_overran_is_not_the_next_one_if_there_is_another():
    limit = OverrunLimit(3)
    end(limit, GO, True)
    assert allowed(limit) == [WAIT, LOOK]
    assert allowed(limit, [0, 1, 0]) == [GO]
    end(limit, WAIT, False)
    assert allowed(limit) == [WAIT, GO, LOOK]


def test_an_option_that_overran_too_often_in_a_row_is_barred_until_the_robot_restarts():
    limit = OverrunLimit(2)
    for overran in (True, False, True, True):
        assert GO in allowed(limit, [0, 1, 0])
        end(limit, GO, overran)
        end(limit, WAIT, False)
    assert allowed(limit) == [WAIT, LOOK]
    assert limit.verdict(AGENT, np.zeros(0), WAIT) == ""
    assert "r0 is given up: it exceeded the maximum duration of 'go' 2 times" in limit.verdict(AGENT, [1, 1, 0], WAIT)
    limit.forget("r0")
    assert allowed(limit) == [WAIT, GO, LOOK]


def test_without_a_limit_nothing_is_barred():
    limit = OverrunLimit(0)
    for _ in range(20):
        end(limit, GO, True)
    assert limit.verdict(AGENT, [1, 1, 0], WAIT) == ""


def test_a_robot_that_ends_an_option_at_its_own_deadline_overran_it():
    """Its clock may be a little ahead of the coordinator's."""
    limit = OverrunLimit(1)
    limit.began("r0", GO, 10.0)
    limit.ended("r0", GO, 69.5, 60.0)
    assert allowed(limit) == [WAIT, LOOK]


def test_an_option_that_was_only_claimed_to_run_bars_nothing():
    limit = OverrunLimit(1)
    limit.ended("r0", GO, 1e6, 60.0)
    limit.began("r0", LOOK, 10.0)
    limit.ended("r0", GO, 1e6, 60.0)
    assert allowed(limit) == [WAIT, GO, LOOK]


def coordinator(robots, most):
    specs = [RobotSpec(Agent(f"r{i}", AGENT.options, 2), (2.0,) * 3) for i in range(robots)]
    times = CoordinatorTimeouts(lost_after=TIMES.lost_after, most_overruns=most)
    team = OneClock(specs, uniform(0), "digest", 0.0, times, 0)
    team.tick(START)
    return team


def overrun(team, agent, count, now, legal=(True, True, False)):
    """Let a robot exceed each of its options; return its last answer."""
    grant = None
    for number in range(1, count + 1):
        answers = team.on_request(request(agent, number, now, legal=np.array(legal)), now)
        answers = answers if answers.grants else team.end_batch(now)
        (grant,) = answers.grants
        if grant.status is GrantStatus.REFUSED:
            return grant, answers, now
        for _ in range(11):
            now += 0.2
            told = running(grant, min(now, 2.0))
            team.on_status(told, now)
            team.tick(now)
    return grant, answers, now


def test_a_robot_that_never_arrives_is_given_up_and_the_run_ends_with_a_verdict():
    team = coordinator(1, 2)
    grant, answers, now = overrun(team, "r0", 20, START, (False, True, False))
    assert grant.status is GrantStatus.REFUSED
    assert "given up: it exceeded the maximum duration of 'go' 2 times in a row" in grant.reason
    (step,) = answers.steps
    assert (step.terminated, step.truncated) == (False, True)
    again = team.on_request(request("r0", grant.request_id + 1, now, legal=np.array((False, True, False))), now)
    assert (again.steps, again.grants[0].status) == ([], GrantStatus.REFUSED)
    restarted = request("r0", 1, now, incarnation=9, legal=np.array((False, True, False)))
    team.tick(now + 0.6)
    answers = team.on_request(restarted, now + 0.6)
    answers = answers if answers.grants else team.end_batch(now + 0.6)
    assert answers.grants[0].status is GrantStatus.GRANTED
