"""No robot is stuck at a door that the certificate lets it through, though its driver aims off the middle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_safety.filter import least_passage
from doors.command import drive_pair, main
from doors.drives import MODELS

from ctrl_rl_core import read_results


@pytest.mark.parametrize("robot", list(MODELS))
def test_a_driver_who_aims_off_the_middle_is_led_through_a_door(robot: str) -> None:
    first = 1001 if robot == "turtlebot3_waffle" else 1000  # even seeds have recoverable sets: a waffle's take long
    pairs = [drive_pair(robot, seed) for seed in (first, 1003)]
    assert all(each.bare.passed and each.filtered.passed for each in pairs)
    assert float(np.median([each.ratio for each in pairs])) < 1.15


@pytest.mark.parametrize("robot", list(MODELS))
def test_a_door_needs_room_for_the_errors_of_echoes_and_of_the_motion_until_the_robot_stands(robot: str) -> None:
    model = MODELS[robot]
    slow, fast = (least_passage(model, speed) for speed in (0.1 * model.speed, model.speed))
    errors = 4.0 * model.range_error + 2.0 * model.disturbance * (model.delay + model.scan_age)
    assert 2.0 * model.half_width + errors < slow < fast
    assert slow - least_passage(model, 0.1 * model.speed, echo_error=0.0) == pytest.approx(2.0 * model.range_error)


def test_it_writes_who_was_stuck_and_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "doors.json"
    words = ["doors", "--episodes", "1", "--robots", "turtlebot3_burger", "--output", str(output)]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 0
    (experiment,) = read_results(tmp_path)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    assert values["turtlebot3_burger", "stuck"] == [0.0]
    assert values["turtlebot3_burger", "time over unfiltered"][0] < 1.3
    assert "turtlebot3_burger" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--robots", "r2d2"], ["--episodes", "0"]])
def test_what_cannot_be_driven_is_one_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["doors", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("doors: ")
