"""The watchdog's logic: when commands pass, when zeros replace them, and which values are refused."""

import math

from ctrl_rl_core.driving.watchdog import Watchdog
from ctrl_rl_core.driving.watchdog_node import refusal
from geometry_msgs.msg import Twist
from hypothesis import given
from hypothesis import strategies as st

TIMEOUT, PERIOD, REPEAT = 0.5, 0.1, 2.0


@given(st.lists(st.tuples(st.sampled_from(["command", "tick"]), st.floats(0.0, 1.5)), max_size=60))
def test_a_robot_never_drives_longer_than_the_time_out_on_an_old_command(events: list[tuple[str, float]]) -> None:
    """For any order and delay of commands and ticks."""
    now, passed_at, ticked_at = 100.0, -math.inf, 100.0
    watchdog = Watchdog(now, TIMEOUT, PERIOD, REPEAT)
    for kind, wait in events:
        now += wait
        frozen = now - ticked_at > TIMEOUT
        if frozen or kind == "tick":
            ticked_at = now
        if kind == "command":
            if watchdog.passes(now):
                assert not frozen, "it may have waited as long as this process slept"
                passed_at = now
        else:
            zero = watchdog.tick(now)
            assert zero or now - passed_at <= TIMEOUT or now - passed_at > REPEAT
            if frozen:
                assert zero


def test_zeros_repeat_for_a_while_or_for_ever() -> None:
    for repeat, expected in ((2.0, [True, True, False]), (0.0, [True, True, True])):
        watchdog = Watchdog(0.0, 1000.0, PERIOD, repeat)
        assert [watchdog.tick(now) for now in (0.1, 1.9, 100.0)] == expected


@given(st.floats(), st.sampled_from("xyz"), st.sampled_from(["linear", "angular"]))
def test_only_finite_numbers_in_range_pass(value: float, axis: str, part: str) -> None:
    twist = Twist()
    setattr(getattr(twist, part), axis, value)
    limit = {"linear": 0.22, "angular": 2.84}[part]
    reason = refusal(twist, 0.22, 2.84)
    assert bool(reason) != (abs(value) <= limit * (1 + 1e-6))
    if reason:
        assert f"{part}.{axis}" in reason
