"""Delivery team: its file, a robot's options, steering, and the policies without a file."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from option_coordinator.navigation.planner import STAND, ReactivePlanner, scan_points
from option_coordinator.policies.policy_query import PolicyQuery
from option_coordinator.scripted.policy_queries import spread_policy, uniform_policy
from option_coordinator.teams.delivery import Delivery
from option_coordinator.teams.team_file import FOLDER

from ctrl_rl_core import ScanGeometry
from option_coordinator import OptionError, load_team, team_file

TEAM = load_team("delivery_team")
WAIT, SHELF, OTHER_SHELF, DESK, _, HOME = range(6)


def carry_out(delivery, option, begin=0.0, way=2.0):
    """Return the outcome of an option with a path of two seconds."""
    delivery.begin(option, begin)
    assert delivery.at_place(begin + way) is None
    return delivery.at_place(begin + way + 10.0)


def test_a_robot_fetches_delivers_and_goes_home():
    delivery = Delivery(TEAM, "robot_1")
    legal = delivery.see(np.zeros(3)).legal
    assert np.flatnonzero(legal).tolist() == [WAIT, SHELF, OTHER_SHELF]
    for count in range(TEAM.deliveries):
        assert carry_out(delivery, SHELF).reward < 0.0
        assert delivery.carries
        assert carry_out(delivery, DESK).reward > 5.0
        assert delivery.delivered == count + 1
    observation, legal, work = delivery.see(np.array((1.0, 2.0, 3.0)))
    assert work == f"carries=0 delivered={TEAM.deliveries}"
    assert observation.tolist() == [1.0, 2.0, 0.0, TEAM.deliveries]
    assert np.flatnonzero(legal).tolist() == [WAIT, HOME]
    delivery.begin(HOME, 0.0)
    assert delivery.place == TEAM.robots["robot_1"].home
    assert delivery.over(HOME)
    assert not delivery.over(DESK)


def test_an_option_is_paid_for_each_of_its_steps_discounted():
    delivery = Delivery(TEAM, "robot_1")
    delivery.begin(WAIT, 0.0)
    result = delivery.leave(1.0)
    gamma = TEAM.discount
    assert result.steps == 5
    assert result.reward == pytest.approx(TEAM.rewards.step * (1 - gamma**5) / (1 - gamma))


def test_what_is_left_early_brings_no_parcel():
    delivery = Delivery(TEAM, "robot_1")
    delivery.begin(SHELF, 0.0)
    delivery.leave(3.0)
    assert not delivery.carries
    assert delivery.place is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("safe_option: wait", "safe_option: rest", "safe_option: 'rest' is none of the options"),
        ("{work: rest, longest: 60.0 s}", "{work: fetch, longest: 60.0 s}", "need a 'station'"),
        ("longest: 5.0 s", "longest: 5.0", "options.wait.longest"),
        ("deliveries: 2", "parcels: 2", "deliveries"),
    ],
)
def test_a_wrong_team_is_refused_with_its_key(tmp_path, old, new, words):
    file = tmp_path / "team.yaml"
    file.write_text((FOLDER / "delivery_team.yaml").read_text().replace(old, new))
    with pytest.raises(OptionError, match=words) as error:
        load_team(str(file))
    assert str(file) in str(error.value)


def test_an_unknown_team_is_told_which_there_are():
    with pytest.raises(OptionError, match="there is delivery_team"):
        team_file("nobody")


@settings(deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi, math.pi), st.integers(0, 2**32 - 1))
def test_a_robot_stays_within_its_speeds_and_never_drives_at_what_is_near(x, y, theta, seed):
    steering = ReactivePlanner()
    random = np.random.default_rng(seed)
    angles, ranges = random.uniform(-math.pi, math.pi, 40), random.uniform(0.15, 2.0, 40)
    points = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles)))
    pose, c, s = np.array((x, y, theta)), math.cos(theta), math.sin(theta)
    speed, turn = steering.command(pose, pose[:2] + points @ np.array(((c, s), (-s, c))), (0.0, 0.0))
    assert 0.0 <= speed <= steering.speed
    assert abs(turn) <= steering.turn
    ahead = points[(np.abs(points[:, 1]) < steering.half_width) & (points[:, 0] > 0.0), 0]
    if len(ahead) and ahead.min() < steering.stop:
        assert speed == 0.0


def test_a_robot_drives_straight_where_nothing_is_and_passes_on_the_right():
    steering, pose, nothing = ReactivePlanner(), np.zeros(3), np.empty((0, 2))
    assert steering.command(pose, nothing, (1.0, 0.0)) == (steering.speed, 0.0)
    assert steering.command(pose, nothing, (0.05, 0.0)) == STAND
    _, turn = steering.command(pose, np.array([(0.5, 0.0)]), (2.0, 0.0))
    assert turn < 0.0


def test_points_of_a_scan_leave_out_what_was_not_seen():
    ranges = np.array((1.0, math.inf, math.nan, 2.0, 0.0), np.float32)
    lidar = ScanGeometry(5, 0.0, math.pi / 2, 0.1, 3.5)
    points = scan_points(np.zeros(3), ranges, lidar, -0.5)
    np.testing.assert_allclose(points, [(0.5, 0.0), (-0.5, -2.0)], atol=1e-9)
    points = scan_points(np.array((1.0, 2.0, math.pi / 2)), ranges, lidar, -0.5)
    np.testing.assert_allclose(points, [(1.0, 2.5), (3.0, 1.5)], atol=1e-9)


def choice(running, legal, places=((0.0, 0.0),) * 3):
    running = np.array(running)
    observation = np.array([(*place, 0.0, 0.0) for place in places], np.float32).ravel()
    return PolicyQuery(observation, running < 0, running, np.array(legal, bool))


FETCH = [1, 1, 1, 0, 0, 0]


@pytest.mark.parametrize(
    ("running", "places", "expected"),
    [
        ([-1, -1, WAIT], [(-1.0, -0.2), (-1.5, 0.0), (0.0, 0.0)], [SHELF, OTHER_SHELF, WAIT]),  # the least sum
        ([SHELF, -1, WAIT], [(0.0, 0.0), (-1.5, 0.9), (0.0, 0.0)], [SHELF, OTHER_SHELF, WAIT]),  # the nearest is taken
        ([SHELF, OTHER_SHELF, -1], [(0.0, 0.0)] * 3, [SHELF, OTHER_SHELF, OTHER_SHELF]),  # both are: it queues
    ],
)
def test_robots_spread_by_travel_and_queueing_times(running, places, expected):
    options, log_probability = spread_policy(TEAM)(choice(running, [FETCH] * 3, places))
    assert options.tolist() == expected
    assert log_probability == 0.0


def test_many_may_go_home_at_a_time():
    options, _ = spread_policy(TEAM)(choice([HOME, -1, -1], [[1, 0, 0, 0, 0, 1]] * 3))
    assert options.tolist() == [HOME, HOME, HOME]


def test_a_robot_that_may_only_wait_waits():
    options, _ = spread_policy(TEAM)(choice([-1, -1, -1], [[1, 0, 0, 0, 0, 0], FETCH, FETCH]))
    assert options[0] == WAIT


def test_any_legal_option_is_as_likely():
    chooses = uniform_policy(np.random.default_rng(0))
    asked = choice([-1, -1, HOME], [[1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 0], [1] * 6])
    drawn = [chooses(asked) for _ in range(50)]
    assert {tuple(options) for options, _ in drawn} == {(a, b, HOME) for a in (0, 1, 2) for b in (3, 4)}
    assert {round(p, 6) for _, p in drawn} == {round(-math.log(6), 6)}
