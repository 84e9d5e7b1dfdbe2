"""A drive ends with the episode, or after the maximum distance."""

import pytest
from ctrl_rl_core.driving.driver_node import ENDED, Arrival
from hypothesis import given
from hypothesis import strategies as st

from ctrl_rl_core import Outcome


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(-0.3, 0.3)), max_size=50), st.floats(0.05, 2.0))
def test_it_ends_when_the_distance_is_driven_and_not_before(steps: list[tuple[float, float]], limit: float) -> None:
    arrival, now, driven = Arrival(limit), 10.0, 0.0
    arrival.moved(now, 0.0)
    for step, speed in steps:
        before, now = now, now + step
        arrival.moved(now, speed)
        driven += abs(speed) * step if now - before <= 1.0 else 0.0
        assert arrival.travelled == pytest.approx(driven, abs=1e-6)
    assert bool(arrival.reason()) == (arrival.travelled >= limit)
    arrival.begin()
    assert not arrival.reason()


@pytest.mark.fault
def test_the_way_of_the_pose_counts_where_the_twist_is_zero() -> None:
    arrival = Arrival(0.3)
    for number in range(200):
        arrival.moved(0.1 * number, 1e-12)
        arrival.went(5.0 + 0.001 * (number % 2), 1.0)
    assert arrival.travelled < 1e-6, "a robot that stands drives nowhere in a little noise"
    for number in range(32):
        arrival.went(5.0, 1.0 + 0.01 * number)
    assert arrival.reason().startswith(f"{ENDED}0.3 m driven")
    arrival.begin()
    arrival.went(-90.0, 0.0)
    assert arrival.travelled == 0.0, "another origin is no way"


def test_numbers_that_make_no_sense_do_not_move_it() -> None:
    arrival = Arrival(1.0)
    for now, speed in ((0.0, 1e9), (0.5, float("nan")), (0.6, float("inf")), (float("nan"), 1.0), (-1e9, 1.0)):
        arrival.moved(now, speed)
    arrival.episode(3, 200)
    assert (arrival.travelled, arrival.reason()) == (0.0, "")


def test_a_new_episode_begins_a_new_drive() -> None:
    arrival = Arrival(0.0)
    assert [arrival.episode(0, outcome) or arrival.reason() for outcome in Outcome] == [
        "",
        f"{ENDED}goal reached (episode 0)",
        f"{ENDED}collision (episode 0)",
        f"{ENDED}trapped (episode 0)",
        f"{ENDED}time-out (episode 0)",
    ]
    arrival.episode(1, Outcome.RUNNING)
    assert not arrival.reason()
