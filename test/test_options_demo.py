"""Three TurtleBots under the coordinator, on real processes: the work is done, and the bag is data to learn from."""

import json
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from commands import check_refused, command

from ctrl_rl_bags import read_messages
from option_coordinator import OptionPolicy, load_team, recordings, team_file

pytestmark = pytest.mark.realtime

TEAM = load_team("delivery_team")


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the shipped team's file with one parcel for each robot, which is the less work."""
    path = tmp_path_factory.mktemp("team") / f"{TEAM.name}.yaml"
    text = team_file(TEAM.name).read_text().replace(f"deliveries: {TEAM.deliveries}", "deliveries: 1")
    path.write_text(text)
    assert load_team(str(path)).deliveries == 1
    return path


@pytest.fixture(scope="module")
def run(team: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    folder = tmp_path_factory.mktemp("options") / "run"
    how = ("--team", team, "--policy", TEAM.name)
    return folder, command("options_demo", "--speed", 3, "--seed", 1, *how, "--output", folder)


def test_all_parcels_are_delivered_and_nobody_collides(run) -> None:
    folder, answer = run
    assert answer.returncode == 0, answer.stderr
    report = json.loads((folder / "report.json").read_text())
    assert report["finished"]
    assert sum(report["options"][name] for name in ("desk_1", "desk_2")) >= len(TEAM.robots)
    assert report["options"]["home"] >= len(TEAM.robots)
    assert report["smallest_clearance_m"] > 0.0
    assert report["messages_lost"] == 0
    assert (folder / "timeline.png").read_bytes().startswith(b"\x89PNG")
    assert "all work done" in answer.stdout
    digest = OptionPolicy.load(TEAM.name).digest
    assert f"policy              {TEAM.name} ({digest[:12]})" in answer.stdout


def test_no_robot_runs_two_options_at_once(run) -> None:
    folder, _ = run
    spans = json.loads((folder / "report.json").read_text())["spans"]
    for robot in TEAM.robots:
        own = sorted((span for span in spans if span["agent"] == robot), key=lambda span: span["begin"])
        assert all(before["end"] <= after["begin"] + 1e-6 for before, after in pairwise(own))


def test_the_bag_is_data_to_learn_from(run) -> None:
    folder, _ = run
    parts = recordings(folder / "bag")
    report = json.loads((folder / "report.json").read_text())
    assert {part.team.names for part in parts} == {tuple(TEAM.robots)}
    steps = [message.data for message in read_messages(folder / "bag", ["/joint_option_step"])]
    assert sum(step.reward for step in steps) == pytest.approx(report["return"])
    # What led to the first decision of a coordinator that took over is no step of its trajectory.
    within = sum(step.reward for step in steps if step.step > 0)
    assert sum(float(np.sum(part.trajectory.reward)) for part in parts) == pytest.approx(within)
    assert parts[-1].trajectory.terminated[-1]
    assert (parts[-1].trajectory.discount < 1.0).any()


def test_the_report_can_be_made_again_from_the_bag_alone(run, team: Path) -> None:
    folder, first = run
    (folder / "timeline.png").unlink()
    again = command("options_report", folder, "--team", team)
    assert again.returncode == 0, again.stderr
    assert again.stdout.splitlines()[:8] == first.stdout.splitlines()[1:9]
    assert (folder / "timeline.png").exists()


@pytest.mark.fault
def test_a_run_that_takes_too_long_is_cut_off_and_says_so(tmp_path: Path) -> None:
    answer = command("options_demo", "--speed", 4, "--limit", 4, "--output", tmp_path / "run")
    assert answer.returncode == 1
    assert "outcome             cut off after" in answer.stdout
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert not report["finished"]
    assert "the limit passed" in report["verdict"]


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--team", "nobody"), "no team 'nobody'"),
        (("--policy", "nowhere.safetensors"), "nowhere.safetensors"),
        (("--speed", "0"), "must be more than 0"),
    ],
)
def test_a_wrong_option_gives_one_clear_message(tmp_path: Path, option: tuple[str, str], words: str) -> None:
    check_refused(words, "options_demo", "--output", tmp_path / "run", *option)
    assert not (tmp_path / "run").exists()
