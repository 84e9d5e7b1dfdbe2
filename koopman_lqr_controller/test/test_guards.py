"""When a robot is stopped, and when it goes on: patience, hysteresis, clocks, each guard turned off."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from koopman_lqr_controller.guards import RELEASE, Alarm, Guard
from koopman_lqr_controller.region import Region

REGION = Region(np.zeros(2), np.eye(2), distance=3.0, error=0.5)
INSIDE, OUTSIDE = np.zeros(2), np.array([4.0, 0.0])


def raised(alarm: Alarm, values: list[float], step: float = 0.2) -> list[bool]:
    return [alarm.see(index * step, value) for index, value in enumerate(values)]


def test_without_patience_it_rises_at_once_and_ends_well_below_its_limit() -> None:
    values = [0.9, 1.1, 0.9, 0.81, 0.79, 0.9]
    assert raised(Alarm(1.0), values) == [False, True, True, True, False, False]


def test_it_takes_patience_to_rise_and_to_end() -> None:
    values = [2.0] * 6 + [0.1] * 7
    assert raised(Alarm(1.0, 1.0), values) == [False] * 5 + [True] * 6 + [False] * 2


def test_what_is_high_only_now_and_then_does_not_raise_it() -> None:
    assert not any(raised(Alarm(1.0, 0.5), [2.0, 2.0, 0.9] * 20))


def test_an_alarm_stays_when_another_limit_changes() -> None:
    guard = Guard(REGION, 2.0, 1.0, 0.0)
    assert "prediction error" in guard.see(0.0, INSIDE, 0.6)
    guard.set_limits(3.0, 1.0, 0.0)
    assert "prediction error" in guard.see(0.2, INSIDE, 0.45), "not well below its limit"
    guard.set_limits(3.0, 2.0, 0.0)
    assert guard.see(0.4, INSIDE, 0.45) == ""


def test_no_value_is_no_news() -> None:
    assert raised(Alarm(1.0, 0.3), [2.0, math.nan, 2.0, math.nan]) == [False, False, True, True]


def test_values_that_are_far_apart_do_not_stay_high() -> None:
    alarm = Alarm(1.0, 1.0)
    assert not any(alarm.see(now, 2.0) for now in (0.0, 60.0, 120.0, 120.8))
    assert alarm.see(121.2, 2.0)


def test_what_cannot_be_watched_any_more_ends_its_alarm() -> None:
    guard = Guard(REGION, 2.0, 1.0, 0.0)
    assert "prediction error" in guard.see(0.0, INSIDE, 0.6)
    assert "prediction error" in guard.see(0.2, INSIDE, math.nan)
    guard.cannot_predict()
    assert guard.see(0.4, INSIDE, math.nan) == ""


def test_a_clock_that_is_set_back_begins_anew() -> None:
    alarm = Alarm(1.0, 0.5)
    assert [alarm.see(now, 2.0) for now in (10.0, 10.4, 0.0, 0.4, 0.6)] == [False, False, False, False, True]


@given(st.lists(st.floats(0.0, 3.0), max_size=50), st.floats(0.0, 2.0))
def test_it_changes_only_beyond_its_limits(values: list[float], patience: float) -> None:
    alarm, before = Alarm(1.0, patience), False
    for index, value in enumerate(values):
        now = alarm.see(0.2 * index, value)
        assert now == before or (value > 1.0 if now else value < RELEASE)
        before = now


def test_a_limit_of_zero_is_none() -> None:
    assert not any(raised(Alarm(0.0), [1e9] * 5))


def test_a_latent_outside_stops_the_robot_and_one_inside_lets_it_go() -> None:
    guard = Guard(REGION, 1.0, 1.0, 1.0)
    assert guard.see(0.0, INSIDE, 0.0) == ""
    assert "left the region" in guard.see(0.2, OUTSIDE, 0.0)
    assert guard.outside == pytest.approx(4.0 / 3.0)
    assert "left the region" in guard.see(0.4, np.array([2.9, 0.0]), 0.0)
    assert guard.see(0.6, INSIDE, 0.0) == ""


def test_an_error_that_stays_high_stops_the_robot() -> None:
    guard = Guard(REGION, 1.0, 1.0, 0.5)
    answers = [guard.see(0.2 * index, INSIDE, 0.6) for index in range(5)]
    assert [bool(answer) for answer in answers] == [False, False, False, True, True]
    assert "prediction error" in answers[-1]


@pytest.mark.parametrize("off", [Guard(REGION, 0.0, 0.0, 0.0), Guard(None, 1.0, 1.0, 0.0)])
def test_guards_can_be_turned_off_and_are_off_where_nothing_is_known(off: Guard) -> None:
    assert [off.see(0.2 * index, OUTSIDE, 9.0) for index in range(5)] == [""] * 5
    assert math.isnan(off.outside) == (off.region is None)
