"""One command from bags to a policy with a verdict: what it says, where it goes on, and what it refuses in one line."""

import json
from pathlib import Path

import pytest
from ctrl_rl_learning.cli.improve import improve
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline import ScriptedDriver, drive, load_transitions
from ctrl_rl_learning.offline.data.held_out import hold_out

from ctrl_rl_core import Actor, load_navigation_task, load_policy

TASK = load_navigation_task("car_navigation")
QUICK = ("--method", "bc", "--updates", "100", "--fit-updates", "50", "--fits", "1")


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> Path:
    """Give a bag of many drives, and one of few."""
    folder = tmp_path_factory.mktemp("drives")
    drive(TASK, ScriptedDriver(TASK), 24, 0, folder / "many")
    drive(TASK, ScriptedDriver(TASK), 6, 100, folder / "few")
    return folder


def run(capsys, *words: object) -> tuple[int, str, str]:
    """Return exit code, output and errors of the command."""
    code = improve([str(word) for word in words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_it_says_what_the_bags_hold_learns_judges_and_goes_on(bags: Path, tmp_path: Path, capsys) -> None:
    words = (bags / "many", "--output", tmp_path / "out", *QUICK)
    code, said, _ = run(capsys, *words)
    assert code == 1, "a clone of a careless driver is not better than he"
    for line in (
        "task       car_navigation: ",
        "bags       24 episodes, ",
        "ended      success ",
        "scans      every 0.4 s; commands come ",
        "rewards    none but the task's",
        "parts      14 episodes to learn from, 10 held out",
        "held out   episodes that the policy was not fitted to: 10 of ",
        "verdict    not shown to be better",
        "record     ",
        "drive it   ros2 run ctrl_rl_core policy --ros-args -p policy:=",
    ):
        assert any(each.startswith(line) for each in said.splitlines()), (line, said)
    policy = tmp_path / "out" / "policy.safetensors"
    assert load_policy(policy).needs == {"pose"}
    assert Actor.load(policy).manifest["learnt_from"]["episodes"] == 14
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] in ("not shown", "worse")
    assert (tmp_path / "out" / "report.txt").read_text() in said

    before = policy.stat().st_mtime_ns
    again = run(capsys, *words)
    assert (again[0], policy.stat().st_mtime_ns) == (1, before), "what is there is not learnt again"
    assert again[1] == said
    (tmp_path / "out" / "report.json").unlink()  # cut off after learning
    assert run(capsys, *words)[1] == said
    assert policy.stat().st_mtime_ns == before

    code, _, errors = run(capsys, *words, "--seed", "1")
    assert code == 1
    assert "was learnt with other episodes: name another --output" in errors.splitlines()[-1]
    assert run(capsys, *words, "--seed", "1", "--overwrite")[0] == 1
    assert policy.stat().st_mtime_ns != before


@pytest.mark.fault
def test_it_refuses_in_one_line_where_it_must(bags: Path, tmp_path: Path, capsys) -> None:
    for words, reason in (
        ((bags / "few",), "6 episodes are too few to learn from 10 and judge by 10 others: record 14 more"),
        ((bags / "nowhere",), "no such bag"),
        ((bags / "many", "--task", "car_ttr"), "was recorded in another task than 'car_ttr'"),
        ((bags / "many", "--task", "quad_ttr"), "is steered by T_1 and T_2"),
        ((bags / "many", "--method", "iql"), "relabel them first"),
    ):
        code, _, errors = run(capsys, *words, "--output", tmp_path / "out")
        assert code == 1, words
        assert reason in errors.splitlines()[-1], words
        assert "Traceback" not in errors
    assert not (tmp_path / "out" / "policy.safetensors").exists()


def test_episodes_are_held_out_whole_and_each_is_in_one_part(bags: Path) -> None:
    transitions = load_transitions([bags / "many"], TASK)
    parts = hold_out(transitions, 0.25, 0)
    assert [part.episode_count for part in parts] == [14, 10]
    first, second = (set(part.episodes.tolist()) for part in parts)
    assert first | second == set(transitions.episodes.tolist())
    assert not first & second
    assert all(part.first[0] for part in parts)
    assert set(hold_out(transitions, 0.25, 1)[1].episodes.tolist()) != second
    assert hold_out(transitions, 0.5, 0)[1].episode_count == 12
    with pytest.raises(LearningError, match="record 6 more"):
        hold_out(transitions.rows(transitions.episodes < 14), 0.25, 0)
