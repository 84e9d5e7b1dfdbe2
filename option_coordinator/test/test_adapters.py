"""PettingZoo's API test, pictures and commands."""

import json
import subprocess
import sys
import warnings
from contextlib import suppress

import numpy as np
import pytest
from ctrl_rl_core.plots import style
from matplotlib import pyplot as plt
from option_coordinator.cli import replay
from option_coordinator.environments.option_env import Span
from option_coordinator.plots import draw_replay, draw_spans, draw_timeline
from option_coordinator.training.cli.learning import evaluate, plot, train, training_figures
from option_coordinator.training.parallel_environment import ParallelOptions
from pettingzoo.test import parallel_api_test
from PIL import Image

from ctrl_rl_core import CtrlRlError
from option_coordinator import make_environment


@pytest.mark.parametrize("task", ["tool_delivery", "water_filling"])
@pytest.mark.parametrize("synchronisation", ["async", "wait", "cut"])
def test_pettingzoo_accepts_it(task, synchronisation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(ParallelOptions(make_environment(task, synchronisation)), num_cycles=200)


def test_a_running_agent_may_only_go_on():
    environment = ParallelOptions(make_environment("tool_delivery"))
    observations, told = environment.reset(seed=0)
    assert observations["fetchbot"]["action_mask"].tolist() == [1] * 6
    observations, rewards, _, _, told = environment.step({"turtlebot_0": 2, "turtlebot_1": 2, "fetchbot": 0})
    assert observations["turtlebot_0"]["action_mask"].tolist() == [0, 0, 1]
    assert rewards == {"turtlebot_0": -1.0, "turtlebot_1": -1.0, "fetchbot": -1.0}
    assert told["fetchbot"] == {"duration": 1, "discount": 0.99, "ready": True}
    assert not told["turtlebot_0"]["ready"]
    with pytest.raises(CtrlRlError, match="still runs option 2"):
        environment.step({"turtlebot_0": 0, "turtlebot_1": 2, "fetchbot": 0})
    environment.step({"fetchbot": 0})  # who runs on need not be named
    with pytest.raises(CtrlRlError, match="ready are"):
        environment.step({"turtlebot_0": 2, "turtlebot_1": 2})


def test_an_episode_must_be_there_to_be_drawn(tmp_path):
    environment = make_environment("tool_delivery")
    with pytest.raises(CtrlRlError, match="play one first"):
        draw_timeline(environment, "", tmp_path / "x.png")
    environment.reset(0)
    with pytest.raises(CtrlRlError, match="film=True"):
        draw_replay(environment, "", tmp_path / "x.gif")


def test_labels_of_a_timeline_name_what_repeats_once_and_never_overlap():
    waits = [Span("a", "wait", 2.0 * i, 2.0 * i + 2.0, True) for i in range(5)]
    others = [
        Span("a", "shelf", 10.0, 60.0, True),
        Span("a", "wait", 60.0, 62.0, True),
        Span("a", "go", 62.1, 62.2, True),
    ]
    with style():
        figure, ax = plt.subplots(figsize=(10.0, 2.0))
    draw_spans(ax, [*waits, *others, Span("b", "shelf", 0.0, 90.0, False)], ("a", "b"), ("wait", "shelf", "go"))
    assert [(text.get_text(), text.get_rotation()) for text in ax.texts] == [
        ("wait", 0.0),
        ("shelf", 0.0),
        ("wait", 90.0),
        ("shelf", 0.0),
    ]
    assert "1 go" in ax.get_xlabel()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert not any(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])
    plt.close(figure)


def test_replay_tells_and_draws(tmp_path, capsys):
    line, film = tmp_path / "line.png", tmp_path / "film.gif"
    assert replay(["tool_delivery", "--timeline", str(line), "--animation", str(film)]) == 0
    said = capsys.readouterr().out
    assert "done after 40 steps (40 s), 19 decisions" in said
    assert "return     260" in said
    with Image.open(film) as picture:
        assert picture.n_frames == 41
    with Image.open(line) as picture:
        assert np.asarray(picture.convert("L")).std() > 10.0


@pytest.mark.usefixtures("runs_here")
def test_commands_from_training_to_replay(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--task", "tool_delivery", "--methods", "async_autoregressive", "--seeds", "1", "--samples", "7500"]
    arguments += ["--evaluations", "1"]
    assert train([*arguments, "--results", "r.json"]) == 0
    assert "any-order autoregressive" in capsys.readouterr().out
    content = json.loads((tmp_path / "r.json").read_text())
    rows = {(row["method"], row["metric"]): row for row in content["rows"]}
    assert rows["scripted", "return"]["mean"] == 260.0
    assert len(rows["async_autoregressive", "makespan"]["values"]) == 1
    assert ("async_autoregressive", "return, draws") in rows
    assert ("async_autoregressive", "seeds that reach 230 in learning") in rows
    assert ("async_autoregressive", "return, most likely options") in rows
    assert content["figures"]["curves"]["async_autoregressive"]["samples"][-1] >= 7500
    assert training_figures(["r.json", "--output", "."]) == 0
    assert "its new name is plot" in capsys.readouterr().err
    assert (tmp_path / "tool_delivery_options.svg").is_file()
    policy = "runs/options/tool_delivery-async_autoregressive-s0/policy.safetensors"
    assert replay(["tool_delivery", "--policy", policy, "--choose", "mode"]) == 0
    assert "decisions" in capsys.readouterr().out
    assert evaluate([policy, "--episodes", "3", "--results", "evaluated.json"]) == 0
    assert "episodes   3 of tool_delivery, from seed 0" in capsys.readouterr().out
    assert replay(["water_filling", "--policy", policy]) == 1
    assert "was learned for task 'tool_delivery'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "arguments", "words"),
    [
        (replay, ["car_ttr"], "one with options is needed"),
        (replay, ["tool_delivery", "--policy", "nowhere.safetensors"], "nowhere.safetensors"),
        (train, ["--task", "tool_delivery", "--seeds", "0"], "must be a whole number of at least 1"),
        (train, ["--task", "tool_delivery", "--workers", "-1"], "--workers must be a whole number of at least 0"),
        (train, ["--task", "tool_delivery", "--samples", "100"], "--samples must be at least 7500"),
        (train, ["--task", "tool_delivery", "--sight", "image"], "no images"),
        (train, ["--task", "tool_delivery", "--methods", "async_thesis_options"], "has no method async_thesis_options"),
        (train, ["--task", "delivery_team", "--methods", "end2end"], "has no method end2end"),
        (train, ["--task", "nowhere"], "tool_delivery, water_filling, delivery_team, or give a .yaml file"),
        (plot, ["nowhere.json"], "no such file"),
    ],
)
def test_errors_are_one_line(command, arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with suppress(SystemExit):  # a command line that is refused
        assert command(arguments) == 1
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_help_does_not_wait_for_torch():
    code = "import sys, option_coordinator.cli, option_coordinator.training.cli.learning; print('torch' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "False"
