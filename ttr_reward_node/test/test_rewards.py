"""Rewards of thesis Table 3.3, against an independent implementation of their formulas."""

import math
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_core.tasks import RegionSpec, RewardSpec
from hypothesis import given
from hypothesis import strategies as st
from ttr_reward_node.rewards.rewards import DISTANCE_WEIGHTS, longest_time

from ctrl_rl_core import (
    Axis,
    Disc,
    Interval,
    Outcome,
    Region,
    ValueFunctionError,
    ValueGrid,
    load_navigation_task,
    task_digest,
    terminal_reward,
)
from ttr_reward_node import (
    REWARDS,
    RewardEvaluator,
    TimeToReachError,
    distance_reward,
    make_reward,
    time_to_reach_reward,
)

CAR = load_navigation_task("car_ttr")
NAMES = ("x", "y", "theta")
angles = st.floats(-math.pi, math.pi)
places = st.floats(-5.0, 5.0)


def car_value(values: np.ndarray) -> ValueGrid:
    """Return a function of the car's states from values at 3 x 3 x 4 nodes."""
    axes = (
        Axis("x", "m", -5.0, 5.0, 3),
        Axis("y", "m", -5.0, 5.0, 3),
        Axis("theta", "rad", -math.pi, math.pi, 4, True),
    )
    return ValueGrid(values, axes, "time_to_reach", CAR.name, task_digest(CAR), "test", 0.0)


@given(st.floats(0.0, 1e6), st.floats(0.0, 100.0))
def test_time_to_reach_is_paid_up_to_the_longest(phi, longest):
    assert time_to_reach_reward(phi, longest) == -min(phi, longest)


def test_where_no_goal_can_be_reached_the_longest_is_paid():
    assert time_to_reach_reward([math.inf, math.nan, 3.0], 14.0).tolist() == [-14.0, -14.0, -3.0]


@given(places, places, angles, st.sampled_from(sorted(DISTANCE_WEIGHTS.values())))
def test_distance_is_that_of_table_3_3(x, y, theta, weight):
    turn = (theta - 0.75 + math.pi) % (2 * math.pi) - math.pi
    expected = -math.sqrt((x - 4.0) ** 2 + (y - 4.0) ** 2 + weight * turn**2)
    assert distance_reward([[x, y, theta]], NAMES, CAR.goal.region, weight)[0] == pytest.approx(expected, abs=1e-9)


def test_an_angle_is_weighed_the_short_way_round():
    near, far = distance_reward([[4.0, 4.0, -3.0], [4.0, 4.0, 0.75 - math.pi]], NAMES, CAR.goal.region, 1.0)
    assert near == pytest.approx(-(2 * math.pi - 3.75))
    assert far == pytest.approx(-math.pi)


def test_an_end_pays_what_the_task_says():
    rewards = RewardSpec(goal=1000.0, collision=-400.0, timeout=-300.0, trap=100.0, tilt=-800.0)
    outcomes = [Outcome.RUNNING, Outcome.GOAL, Outcome.COLLISION, Outcome.TRAP, Outcome.TIMEOUT, Outcome.COLLISION]
    paid = terminal_reward(outcomes, rewards, [False, False, False, False, False, True])
    assert paid.tolist() == [0.0, 1000.0, -400.0, 100.0, -300.0, -800.0]


@pytest.mark.parametrize("name", REWARDS)
def test_every_reward_ends_alike(name):
    reward = make_reward(name, CAR, car_value(np.full((3, 3, 4), 7.0)))
    states = np.array([[4.0, 4.0, 0.75], [0.0, 0.0, 0.0], [1.0, -3.0, 1.0]])
    paid = reward(states, [Outcome.GOAL, Outcome.COLLISION, Outcome.RUNNING])
    assert paid[:2].tolist() == [1000.0, -400.0]
    assert paid[2] == reward.intermediate(states[2:])[0]


def test_rewards_of_a_state_on_the_way():
    states = np.array([[0.0, -3.0, 0.75]])
    value = car_value(np.full((3, 3, 4), 7.0))
    paid = {name: float(make_reward(name, CAR, value).intermediate(states)[0]) for name in REWARDS}
    assert paid["sparse"] == 0.0
    assert paid["ttr"] == -7.0
    assert all(paid[name] == pytest.approx(-math.hypot(4.0, 7.0)) for name in DISTANCE_WEIGHTS)


def test_outside_the_grid_the_nearest_state_inside_counts():
    values = np.zeros((3, 3, 4))
    values[2] = 9.0
    reward = make_reward("ttr", CAR, car_value(values))
    assert reward.intermediate([[50.0, 0.0, 0.0]]).tolist() == [-9.0]


def test_the_longest_time_is_the_largest_finite_one():
    values = np.full((3, 3, 4), 4.0)
    values[0, 0] = 11.0
    values[1, 1] = math.inf
    function = car_value(values)
    assert longest_time(function) == 11.0
    assert make_reward("ttr", CAR, function).intermediate([[0.0, 0.0, 0.0]]).tolist() == [-11.0]


def test_a_value_of_something_else_is_refused():
    value = car_value(np.zeros((3, 3, 4)))
    with pytest.raises(ValueFunctionError, match="belongs to task 'car_ttr', not 'quad_ttr'"):
        make_reward("ttr", load_navigation_task("quad_ttr"), value)
    with pytest.raises(ValueFunctionError, match="holds 'oc_value'"):
        make_reward("ttr", CAR, replace(value, kind="oc_value"))
    with pytest.raises(TimeToReachError, match="another version of task 'car_ttr': solve the task again"):
        make_reward("ttr", CAR, replace(value, task_digest="0" * 64))


def test_what_is_missing_or_unknown_is_said():
    with pytest.raises(TimeToReachError, match="solve the task first"):
        make_reward("ttr", CAR)
    with pytest.raises(TimeToReachError, match="no reward 'dense': there are sparse"):
        make_reward("dense", CAR)


def test_a_disc_has_a_middle_too():
    goal = Region({"theta": Interval(0.5, 1.0)}, Disc((4.0, 4.0), 0.5))
    assert distance_reward([[0.0, 1.0, 0.75]], NAMES, goal, 10.0)[0] == pytest.approx(-5.0)
    assert distance_reward([[4.0, 4.0, 1.75]], NAMES, goal, 10.0)[0] == pytest.approx(-math.sqrt(10.0))


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ({"disc": {"centre": "(4, 4) m", "radius": "1 m"}}, "interval of one angle"),
        ({"x": "3 .. 4 m", "theta": "0 .. 1 rad"}, "a disc, or with intervals of two positions"),
    ],
)
def test_a_distance_to_a_goal_without_a_middle_is_refused_before_anything_is_learnt(goal, words):
    task = CAR.model_copy(update={"goal": RegionSpec.model_validate(goal)})
    with pytest.raises(TimeToReachError, match=words):
        make_reward("distance_1", task)
    assert make_reward("sparse", task).name == "sparse"


@pytest.mark.fault
@pytest.mark.parametrize(
    "values", [np.full((3, 3, 4), np.inf), np.where(np.arange(4) > 1, np.inf, np.zeros((3, 3, 4)))]
)
def test_a_value_that_knows_no_way_is_refused(values):
    with pytest.raises(TimeToReachError, match="nothing outside the goal reaches it"):
        make_reward("ttr", CAR, car_value(values))
    with pytest.raises(TimeToReachError, match="nothing outside the goal reaches it"):
        RewardEvaluator(CAR, car_value(values))
