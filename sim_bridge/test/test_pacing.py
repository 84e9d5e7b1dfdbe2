import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim_bridge.ros.pacing import LONGEST_GAP, Pacer, Schedule, SpeedMeter


@given(st.lists(st.floats(0.0, 0.09), min_size=10, max_size=100), st.floats(0.1, 30.0))
def test_steps_follow_wall_time_without_loss(gaps, factor):
    pacer, now, steps = Pacer(240), 5.0, 0
    pacer.due(now, factor)
    for gap in gaps:
        now += gap
        steps += pacer.due(now, factor)
    assert abs(steps - (now - 5.0) * factor * 240) <= 1.0 + 1e-6


def test_a_long_gap_is_not_made_up_for():
    pacer = Pacer(240)
    pacer.due(0.0, 1.0)
    assert pacer.due(60.0, 1.0) == int(LONGEST_GAP * 240)
    pacer.rest()
    assert pacer.due(120.0, 1.0) == 0


@given(st.floats(0.5, 240.0))
def test_a_schedule_keeps_its_frequency(frequency):
    schedule = Schedule(frequency, 240)
    times = [step for step in range(2400) if schedule.due(step)]
    assert times[0] == 0
    assert abs(len(times) - 10 * frequency) <= 1.0 + 1e-6
    assert all(abs(step - index * 240 / frequency) < 1.0 for index, step in enumerate(times))


def test_the_meter_reads_simulation_time_per_wall_time():
    meter = SpeedMeter()
    assert math.isnan(meter.read(1.0, 10.0))
    assert meter.read(3.0, 16.0) == pytest.approx(3.0)
