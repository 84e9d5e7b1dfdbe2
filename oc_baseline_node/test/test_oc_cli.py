"""The oc command: each step, and a clear one-line error if a step is impossible."""

import json
from pathlib import Path

import pytest
from oc_baseline_node.cli import main
from oc_baseline_node.value_data.dataset import description

from ctrl_rl_core import load_navigation_task
from oc_baseline_node import DataSettings, formulate


def test_it_goes_from_a_task_to_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, value, grid = tmp_path / "data", tmp_path / "v.safetensors", tmp_path / "g.safetensors"
    assert main(["extract", "car_navigation"]) == 0
    assert "dubins_car (x, y, theta): meets both criteria, chosen" in capsys.readouterr().out
    making = ["data", "car_navigation", "--output", str(data), "--trajectories", "12", "--workers", "1"]
    assert main(making) == 0
    said = capsys.readouterr().out
    for words in ("12 of 140 steps", "random starts", "CPU seconds"):
        assert words in said
    results = tmp_path / "results.json"
    fitting = ["fit", str(data), "--output", str(value), "--grid", str(grid), "--epochs", "3"]
    assert main([*fitting, "--results", str(results)]) == 0
    assert "held out" in capsys.readouterr().out
    rows = {row["metric"]: row for row in json.loads(results.read_text())["rows"]}
    assert rows["states"]["values"] == [12 * 140]
    assert 0.9 < rows["starts with a trajectory"]["values"][0] <= 1.0
    for file in (value, grid):
        assert main(["map", str(file), "--output", str(tmp_path / "map.png"), "--at", "theta=0.5"]) == 0
    assert (tmp_path / "map.png").exists()
    assert main(["fit", str(data), "--output", str(value)]) == 1
    assert "exists: give another name, or --overwrite" in capsys.readouterr().err


def test_a_trajectory_is_solved_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "one.png"
    assert main(["solve", "car_navigation", "--start=-3,0,1", "--solver", "fatrop", "--output", str(picture)]) == 0
    assert "answer        fatrop: SUCCESS" in capsys.readouterr().out
    assert picture.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["solve", "car_navigation", "--start", "0,0,0"], "inside an obstacle"),
        (["solve", "quad_trap", "--start=0,0,0.6,-2,0,0", "--solver", "ipopt"], "ipopt: "),
        (["extract", "car_ttr"], "oc: task 'car_ttr' has no part 'optimal_control'"),
        (["extract", "nowhere"], "oc: no task 'nowhere'"),
        (["fit", "nowhere", "--output", "x"], "oc: nowhere has no value data"),
        (
            ["map", "nowhere.safetensors", "--output", "x.png"],
            "oc: no value 'nowhere.safetensors': there are",
        ),
    ],
)
def test_what_it_cannot_do_it_says_in_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert words in out + err
    assert "Traceback" not in err
    assert len(err.splitlines()) <= 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["extract", "car_navigation", "--clearance", "-1"], "--clearance is -1"),
        (
            ["data", "car_navigation", "--output", "x", "--trajectories", "0"],
            "--trajectories must be a whole number of at least 1",
        ),
        (
            ["data", "car_navigation", "--output", "x", "--workers", "0"],
            "--workers must be a whole number of at least 1",
        ),
        (
            ["data", "car_navigation", "--output", "x", "--seed", "-1"],
            "--seed must be a whole number of at least 0",
        ),
        (["solve", "car_navigation", "--seed", "-1"], "--seed must be a whole number of at least 0"),
        (
            ["fit", "nowhere", "--output", "x", "--epochs", "0"],
            "--epochs must be a whole number of at least 1",
        ),
        (
            ["fit", "nowhere", "--output", "x", "--seed", "-1"],
            "--seed must be a whole number of at least 0",
        ),
        (["fit", "nowhere", "--output", "x", "--discount", "1.5"], "--discount must lie in"),
        (["solve", "car_navigation", "--start", "1,a"], "--start '1,a' must be numbers with commas between"),
        (["map", "car_navigation", "--output", "x.png", "--at", "theta"], "--at 'theta' must be NAME=VALUE"),
        (["data", "car_navigation"], "oc: missing --output"),
        ([], "oc: give one of: extract, solve, data, fit, map"),
    ],
)
def test_wrong_usage_is_said_in_one_line(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert words in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"form": None, "clearance": "wide"}, "settings.json: form: is missing"),
        ({"trajectories": 0}, "settings.json: trajectories: is 0: must be greater than or equal to 1"),
        ({"form": "quick"}, "no form 'quick': there are"),
    ],
)
def test_a_folder_that_says_nonsense_about_itself_is_refused(
    tmp_path: Path, change: dict[str, object], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    there = description(formulate(load_navigation_task("car_navigation")), DataSettings(10)) | change
    (tmp_path / "settings.json").write_text(json.dumps({k: v for k, v in there.items() if v is not None}))
    assert main(["fit", str(tmp_path), "--output", str(tmp_path / "v.safetensors")]) == 1
    err = capsys.readouterr().err
    assert words in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("command", [[], ["extract"], ["solve"], ["data"], ["fit"], ["map"]])
def test_help_helps(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*command, "--help"])
    assert ended.value.code == 0
    assert "usage: oc" in capsys.readouterr().out
