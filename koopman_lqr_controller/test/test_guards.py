"""Stops and restarts of a robot: patience, hysteresis, clocks, and each guard disabled."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.safety.guards import FORGET_SECONDS, RELEASE, RETRY_SCALE, Alarm, Retries

from koopman_lqr_controller import Guard, LatentDistribution

REGION = LatentDistribution(np.zeros(2), np.eye(2), distance=3.0, error=0.5)
INSIDE, OUTSIDE = np.zeros(2), np.array([4.0, 0.0])


def raised(alarm: Alarm, values: list[float], step: float = 0.2) -> list[bool]:
    return [alarm.update(index * step, value) for index, value in enumerate(values)]


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
    assert "prediction error" in guard.update(0.0, INSIDE, 0.6)
    guard.set_limits(3.0, 1.0, 0.0)
    assert "prediction error" in guard.update(0.2, INSIDE, 0.45), "not well below its limit"
    guard.set_limits(3.0, 2.0, 0.0)
    assert guard.update(0.4, INSIDE, 0.45) == ""


def test_no_value_is_no_news() -> None:
    assert raised(Alarm(1.0, 0.3), [2.0, math.nan, 2.0, math.nan]) == [False, False, True, True]


def test_values_that_are_far_apart_do_not_stay_high() -> None:
    alarm = Alarm(1.0, 1.0)
    assert not any(alarm.update(now, 2.0) for now in (0.0, 60.0, 120.0, 120.8))
    assert alarm.update(121.2, 2.0)


def test_what_cannot_be_watched_any_more_ends_its_alarm() -> None:
    guard = Guard(REGION, 2.0, 1.0, 0.0)
    assert "prediction error" in guard.update(0.0, INSIDE, 0.6)
    assert "prediction error" in guard.update(0.2, INSIDE, math.nan)
    guard.reset_prediction_alarm()
    assert guard.update(0.4, INSIDE, math.nan) == ""


def test_a_clock_that_is_set_back_begins_anew() -> None:
    alarm = Alarm(1.0, 0.5)
    assert [alarm.update(now, 2.0) for now in (10.0, 10.4, 0.0, 0.4, 0.6)] == [False, False, False, False, True]


@given(st.lists(st.floats(0.0, 3.0), max_size=50), st.floats(0.0, 2.0))
def test_it_changes_only_beyond_its_limits(values: list[float], patience: float) -> None:
    alarm, before = Alarm(1.0, patience), False
    for index, value in enumerate(values):
        now = alarm.update(0.2 * index, value)
        assert now == before or (value > 1.0 if now else value < RELEASE)
        before = now


def test_a_limit_of_zero_is_none() -> None:
    assert not any(raised(Alarm(0.0), [1e9] * 5))


def test_a_latent_outside_stops_the_robot_and_one_inside_lets_it_go() -> None:
    guard = Guard(REGION, 1.0, 1.0, 1.0)
    assert guard.update(0.0, INSIDE, 0.0) == ""
    assert "left the region" in guard.update(0.2, OUTSIDE, 0.0)
    assert guard.distance == pytest.approx(4.0 / 3.0)
    assert "left the region" in guard.update(0.4, np.array([2.9, 0.0]), 0.0)
    assert guard.update(0.6, INSIDE, 0.0) == ""


def test_an_error_that_stays_high_stops_the_robot() -> None:
    guard = Guard(REGION, 1.0, 1.0, 0.5)
    answers = [guard.update(0.2 * index, INSIDE, 0.6) for index in range(5)]
    assert [bool(answer) for answer in answers] == [False, False, False, True, True]
    assert "prediction error" in answers[-1]


@pytest.mark.parametrize("off", [Guard(REGION, 0.0, 0.0, 0.0), Guard(None, 1.0, 1.0, 0.0)])
def test_guards_can_be_turned_off_and_are_off_where_nothing_is_known(off: Guard) -> None:
    assert [off.update(0.2 * index, OUTSIDE, 9.0) for index in range(5)] == [""] * 5
    assert math.isnan(off.distance) == (off.distribution is None)


def paces(retries: Retries, alarms: dict[int, bool], seconds: int) -> list[float]:
    """Return the pace of each second; an alarm holds until the next entry changes it."""
    out, alarm = [], False
    for now in range(seconds):
        alarm = alarms.get(now, alarm)
        out.append(retries.update(float(now), alarm))
    return out


@pytest.mark.fault
def test_an_alarm_that_standing_cannot_end_is_tried_again_slowly_and_not_for_ever() -> None:
    """Ten seconds of standing, then three of creeping, twice; then it stands permanently."""
    seen = paces(Retries(wait=10.0, most=2), {0: True}, 100)
    assert seen[:10] == [0.0] * 10
    assert seen[10:13] == [RETRY_SCALE] * 3
    assert sum(speed_scale == RETRY_SCALE for speed_scale in seen) == 6
    assert set(seen[26:]) == {0.0}, "bounded"
    assert set(paces(Retries(wait=0.0, most=0), {0: True}, 20)) == {0.0}


@pytest.mark.fault
def test_a_try_that_ends_the_alarm_drives_on_and_tries_come_back_when_all_was_well_for_long() -> None:
    retries = Retries(wait=2.0, most=1)
    assert paces(retries, {0: True, 3: False}, 5) == [0.0, 0.0, RETRY_SCALE, 1.0, 1.0]
    assert retries.update(5.0, True) == 0.0
    assert {retries.update(float(now), True) for now in range(6, 30)} == {0.0}, "used up"
    assert {retries.update(float(now), False) for now in range(30, 30 + int(FORGET_SECONDS) + 1)} == {1.0}
    assert [retries.update(50.0 + now, True) for now in range(3)] == [0.0, 0.0, RETRY_SCALE]


@given(
    steps=st.lists(st.tuples(st.floats(-5.0, 5.0), st.booleans()), max_size=200),
    wait=st.floats(0.0, 5.0),
    most=st.integers(0, 5),
)
@settings(max_examples=200, deadline=None)
def test_there_are_never_more_tries_than_allowed_whatever_the_clock_does(
    steps: list[tuple[float, bool]], wait: float, most: int
) -> None:
    retries, now = Retries(wait, most), 0.0
    for step, alarm in steps:
        now += step
        speed_scale = retries.update(now, alarm)
        assert retries.used <= most
        assert (speed_scale == 1.0) == (not alarm)
        assert speed_scale in (0.0, RETRY_SCALE, 1.0)
