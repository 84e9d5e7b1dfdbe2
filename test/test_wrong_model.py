"""No robot that is worse than its model, within what its monitor expects, touches a pole at the speed of a walk."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from wrong_model.command import FAULTS, WALKING, WORSE, main
from wrong_model.drives import Fault, ride

from ctrl_rl_core import read_results
from ctrl_rl_safety import ROBOTS


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_a_worse_robot_touches_nothing_from_the_first_metre_on(robot: str) -> None:
    for seed in range(1000, 1003):
        found = ride(robot, seed, WORSE, WALKING, monitored=True)
        assert not found.contact, seed
        assert not math.isnan(found.grown), seed


@pytest.mark.parametrize(("seed", "speed"), [(1003, 1.0), (1025, 2.0)])
def test_a_delay_known_within_bounds_is_reckoned_with_at_both(seed: int, speed: float) -> None:
    # Alternating turns turn this robot elsewhere if they act 50 ms sooner than the longest delay says.
    assert ride("jackal", seed, WORSE, speed, monitored=True).clearance > 0.01


def test_without_a_monitor_it_does() -> None:
    assert any(ride("jackal", seed, WORSE, WALKING, monitored=False).contact for seed in range(4))


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_a_right_model_stays_as_it_is(robot: str) -> None:
    for seed in range(1000, 1002):
        found = ride(robot, seed, FAULTS[0], 20.0, monitored=True)
        assert not found.contact
        assert math.isnan(found.grown), found.words


def test_a_turned_lidar_stops_the_robot_before_a_pole_does() -> None:
    for seed in range(3):
        found = ride("turtlebot2", seed, Fault("", yaw=math.radians(15.0)), WALKING, monitored=True)
        assert found.stands, seed
        assert "lidar is turned" in found.words
        assert not found.contact


def test_it_writes_contacts_and_how_soon_bounds_grew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "wrong_model.json"
    words = ["wrong_model", "--episodes", "1", "--robots", "turtlebot3_burger", "--output", str(output)]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 0
    (experiment,) = read_results(tmp_path)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    name = f"turtlebot3_burger, 0.22 m/s, {WORSE.name}"
    assert values[name, "contacts"] == [0.0]
    assert values[name, "bounds grown after"][0] < 1.0
    assert "turtlebot3_burger, 0.22 m/s" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--robots", "r2d2"], ["--episodes", "0"]])
def test_what_cannot_be_driven_is_one_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["wrong_model", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("wrong_model: ")
