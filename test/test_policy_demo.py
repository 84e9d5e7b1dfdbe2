"""Policies that ship drive and fly in the simulator: real processes, a recorded run, and its report."""

import json
from pathlib import Path

import pytest
from commands import check_refused, command

from ctrl_rl_bags import bag_info

pytestmark = pytest.mark.realtime


def test_a_quadrotor_flies_to_its_goal_behind_its_guard_and_the_flight_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    # Slowly: on a busy machine late thrusts bring a quadrotor down.
    words = ("--task", "quad_navigation", "--filter", "--speed", 0.3, "--seed", 3)
    answer = command("demo", *words, "--output", folder)
    assert answer.returncode == 0, answer.stderr
    report = json.loads((folder / "report.json").read_text())
    assert report["outcome"] == "goal reached"
    assert report["lacks"] == []
    assert report["safety_filter"]["passed"] > 10
    assert "flight guard " in answer.stdout
    assert report["oc_value_at_start"] is not None
    assert (folder / "path.png").read_bytes().startswith(b"\x89PNG")
    topics = bag_info(folder / "bag").topics
    assert topics["/rotor_thrusts"].message_count > 10
    assert "/cmd_vel" not in topics


def test_a_car_drives_from_several_starts_to_its_goal(tmp_path: Path) -> None:
    answer = command("trials", "--task", "car_ttr", "--seeds", 2, "--speed", 4, "--output", tmp_path / "run")
    assert answer.returncode == 0, answer.stderr
    assert "goal reached        2 of 2" in answer.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--task", "car_ttr", "--policy", "quad_navigation"), "is for a planar_quadrotor, the robot of"),
        (("--task", "car_ttr", "--policy", "nobody"), "no policy 'nobody': there are"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused_before_anything_starts(
    tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    check_refused(message, "demo", *words, "--output", tmp_path / "run")
    assert not (tmp_path / "run").exists()
