"""The command `evaluate`: intervals, and what it refuses."""

import numpy as np
import pytest
from ctrl_rl_learning.cli.evaluate import evaluate, mean_interval, success_interval
from ctrl_rl_learning.sb3.environment import observation_names, observation_scales

from ctrl_rl_core import Actor, load_navigation_task, read_results, task_digest


def write(file, changes=()):
    """Write a policy of car_ttr that always commands the middle of what it may."""
    task = load_navigation_task("car_ttr")
    middle, unit = observation_scales(task)
    low, high = np.array(list(task.robot.commands.values()), np.float32).T
    layer = np.zeros((len(low), len(middle)), np.float32)
    told = {"task": task.name, "task_digest": task_digest(task), "commands": list(task.robot.commands)}
    manifest = {**told, "observation": observation_names(task), **dict(changes)}
    Actor((layer,), (layer[:, 0],), "normalized_tanh", True, middle, unit, low, high, manifest).save(file)
    return file


def test_intervals_hold_what_they_should():
    assert success_interval([True] * 8 + [False] * 2) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert success_interval([True] * 10)[1] == 1.0
    assert mean_interval([1.0, 2.0, 3.0]) == pytest.approx((2.0 - 2.4841, 2.0 + 2.4841), abs=1e-3)
    assert np.isnan(mean_interval([1.0])).all()


def test_episodes_are_told_and_written_and_the_same_again(tmp_path, capsys):
    file = write(tmp_path / "policy.safetensors")
    told = []
    for name in ("one", "other"):
        results = tmp_path / name / "results.json"
        assert evaluate([str(file), "--episodes", "3", "--seed", "5", "--results", str(results)]) == 0
        told.append(read_results(results.parent)[0])
    assert told[0].rows == told[1].rows
    assert told[0].seeds == [5, 6, 7]
    assert [(row.metric, len(row.values)) for row in told[0].rows] == [("success", 3), ("return", 3)]
    said = capsys.readouterr()
    assert "episodes   3 of car_ttr, from seed 5\nsuccess    0.0% (95 %: 0.0% to 56.1%)" in said.out
    assert not said.err


@pytest.mark.parametrize(
    ("changes", "words", "message"),
    [
        ({"task": "mine"}, [], "belongs to task 'mine', which is not in the suite: give its file by --task"),
        ({}, ["--task", "quad_ttr"], "its observations are not those of task 'quad_ttr'"),
        ({"commands": ["v"]}, [], "its commands are not those of task 'car_ttr'"),
        ({}, ["--task", "nowhere"], "nowhere"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path, capsys, changes, words, message):
    file = write(tmp_path / "policy.safetensors", changes)
    assert evaluate([str(file), *words]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
