"""No robot touches a thin pole that its lidar has seen, while up to 30 % of the beams and scans are lost."""

from __future__ import annotations

from pathlib import Path

import pytest
from missing_echoes.command import main
from missing_echoes.drives import ride

from ctrl_rl_core import read_results
from ctrl_rl_safety import ROBOTS


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("robot", list(ROBOTS))
def test_no_robot_touches_a_pole_within_the_stated_rate_of_missing(robot: str, lost: float) -> None:
    for seed in range(1000, 1003):
        assert not ride(robot, seed, lost, lost or 0.1).contact, seed


def test_a_robot_that_trusts_each_scan_alone_does() -> None:
    assert any(ride("jackal", seed, 0.3, 0.0).contact for seed in range(4))


def test_it_writes_contacts_and_the_time_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "missing_echoes.json"
    words = ["missing_echoes", "--episodes", "1", "--robots", "turtlebot3_burger", "--output", str(output)]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 0
    (experiment,) = read_results(tmp_path)
    values = {(row.method, row.metric): row.values for row in experiment.rows}
    assert values["turtlebot3_burger, 30% lost", "contacts"] == [0.0]
    assert abs(values["turtlebot3_burger, 0% lost", "time lost"][0]) < 5.0
    assert "turtlebot3_burger, 0% lost" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--robots", "r2d2"], ["--episodes", "0"]])
def test_what_cannot_be_driven_is_one_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["missing_echoes", *words])
    assert main() == 2
    assert capsys.readouterr().err.startswith("missing_echoes: ")
