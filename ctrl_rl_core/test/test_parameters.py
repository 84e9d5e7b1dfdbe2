"""Node parameters: checks, descriptors and help from one table."""

import pytest
from ctrl_rl_core.ros.parameters import help_text

from ctrl_rl_core import Parameter, ParameterError

SPEED = Parameter("speed", 0.2, "Of the robot [m/s].", 0.0, 0.22, live=True)
COUNT = Parameter("count", 3, "How many.", minimum=1)
MODE = Parameter("mode", "slow", "How.", choices=("slow", "fast"))


def test_descriptors_say_range_meaning_and_whether_it_may_change() -> None:
    speed, count = SPEED.descriptor(), COUNT.descriptor()
    assert (speed.floating_point_range[0].from_value, speed.floating_point_range[0].to_value) == (0.0, 0.22)
    assert speed.description == "Of the robot [m/s]."
    assert not speed.read_only
    assert count.integer_range[0].from_value == 1
    assert count.read_only
    assert MODE.descriptor().additional_constraints == "one of: slow, fast"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_refuses_what_is_no_number(value: float) -> None:
    with pytest.raises(ParameterError, match="'speed' must be a finite number"):
        SPEED.check(value)


def test_refuses_what_is_no_choice() -> None:
    MODE.check("fast")
    with pytest.raises(ParameterError, match="'mode' is 'idle': must be one of: slow, fast"):
        MODE.check("idle")


def test_help_names_default_range_and_change() -> None:
    text = help_text("node", "Does it.", [SPEED, COUNT, MODE])
    assert "Of the robot [m/s]. (default 0.2; 0 to 0.22; may change while running)" in text
    assert "How many. (default 3; at least 1)" in text
    assert "How. (default 'slow'; one of: slow, fast)" in text
