"""Learning with each baseline in the real simulator: exact resuming, tables and figures."""

import json
import subprocess
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from ctrl_rl_learning.study import RunOptions
from ctrl_rl_learning.study import train as train_run
from oc_baseline_node.training.cli import plot, train
from oc_baseline_node.training.experiments.methods import GROUPS, METHODS
from oc_baseline_node.training.experiments.results import collect
from oc_baseline_node.training.experiments.runs import OcRun, PaidTimeOut, oc_runs

from ctrl_rl_core import ValueFunctionError, load_navigation_task, task_digest, task_file
from oc_baseline_node import OcError
from sim_bridge import NavigationEnv

RESULTS = Path(__file__).parents[2] / "docs" / "results"
TASK = load_navigation_task("quad_trap")
ROLL_OUT = 128
SHORT = {"iterations": 2, "samples": ROLL_OUT, "evaluations": 1, "final_evaluations": 2}


@pytest.fixture(autouse=True)
def _short_roll_outs(update_every):
    update_every(ROLL_OUT)


def own_task(folder, of, *changes, name=None):
    """Write a task of the suite with replaced lines and return its file."""
    text = task_file(of).read_text(encoding="utf-8")
    for before, after in (*changes, (f"name: {of}", f"name: {name or of}")):
        assert before in text
        text = text.replace(before, after)
    file = folder / f"{name or of}.yaml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize("method", ["oc_ppo", "oc_trpo", "stein", "q_prop", "noise_0.1", "oc_own_end", "oc_corrected"])
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(check_resuming, method):
    check_resuming(train_run, OcRun(TASK, method, 3), partial(RunOptions, **SHORT))


def test_runs_become_a_table_and_pictures(tmp_path, capsys):
    runs = oc_runs(TASK, ("ppo", "oc_ppo", "entropy_0.05"), 2)
    assert [run.method_name for run in runs[:2]] == ["oc_ppo", "oc_ppo"]
    for run in runs:
        train_run(run, RunOptions(tmp_path, **SHORT))
    rows, figures = collect(runs, tmp_path)
    of_trap = next(row for row in rows if (row.method, row.metric) == ("ppo", "trap rate"))
    assert (len(of_trap.values), of_trap.thesis) == (2, 0.65)
    assert np.array(figures["curves"]["ppo"]["total"]).shape == (2, 2)
    assert np.array(figures["advantages"]["oc_ppo"]).shape == (2, 2, 1, 3)
    results = tmp_path / "results.json"
    known = ["--methods", "oc_ppo", "ppo", "entropy_0.05", "--seeds", "2", "--samples", "20480"]
    assert train(["--task", "quad_trap", "--folder", str(tmp_path), *known, "--results", str(results)]) == 0
    assert "PPO, OC baseline" in capsys.readouterr().out
    pictures = tmp_path / "pictures"
    assert plot([str(results), "--output", str(pictures)]) == 0
    assert {"quad_trap_oc_ablation.svg", "quad_trap_oc_advantages.svg", "quad_trap_oc_entropy.svg"} < {
        file.name for file in pictures.iterdir()
    }
    evaluate = Path(get_package_prefix("ctrl_rl_learning")) / "lib" / "ctrl_rl_learning" / "evaluate"
    policy = tmp_path / runs[0].name / "policy.safetensors"
    answer = subprocess.run([evaluate, policy, "--episodes", "2"], capture_output=True, text=True, check=True)
    assert "episodes   2 of quad_trap, from seed 0" in answer.stdout


def test_pictures_show_the_world_of_the_task_that_was_learnt(tmp_path, capsys):
    own = own_task(tmp_path, "quad_trap", name="my_trap")
    paths = [{"outcome": "GOAL", "states": [[0.0, 0.0, 4.0, 0.0, 0.1, 0.0], [1.0, 0.0, 5.0, 0.0, 0.1, 0.0]]}]
    figures = {"curves": {}, "advantages": {}, "paths": {"oc_ppo": paths}}
    terms = {"task": "my_trap", "task_digest": task_digest(load_navigation_task(own))}
    results, where = tmp_path / "results.json", ["--output", str(tmp_path)]
    results.write_text(json.dumps({"figures": {**terms, **figures}}), encoding="utf-8")
    assert plot([str(results), "--task", str(own), *where]) == 0
    assert (tmp_path / "my_trap_oc_paths.png").is_file()
    assert not capsys.readouterr().err
    assert plot([str(results), *where]) == 1
    assert "belongs to task 'my_trap', which is not in the suite: give its file by --task" in capsys.readouterr().err
    assert plot([str(results), "--task", "quad_trap", *where]) == 1
    assert "belongs to task 'my_trap', not 'quad_trap'" in capsys.readouterr().err
    results.write_text(json.dumps({"figures": {**terms, "task": "quad_trap", **figures}}), encoding="utf-8")
    assert plot([str(results), *where]) == 0
    assert "belongs to another version of its task" in capsys.readouterr().err


def test_results_of_something_else_are_not_drawn(capsys, tmp_path):
    other = RESULTS / "oc_mpc_quad_navigation.json"
    assert plot([str(other), "--output", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert "is not a file that `train --results` wrote, it lacks curves, advantages: give one" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(("name", "terminated"), [("quad_trap", True), ("car_navigation", False)])
def test_a_time_out_ends_the_return_where_the_task_pays_for_it(name, terminated):
    task = load_navigation_task(name)
    task = task.model_copy(update={"episode": task.episode.model_copy(update={"steps": 2})})
    environment = PaidTimeOut(NavigationEnv(task))
    environment.reset(seed=0)
    action = np.zeros(2, dtype=np.float32)
    environment.step(action)
    _, reward, ended, truncated, info = environment.step(action)
    environment.close()
    assert (ended, truncated, info["outcome"]) == (terminated, not terminated, "TIMEOUT")
    assert reward == task.rewards.timeout


def test_groups_name_methods():
    assert {name for group in GROUPS.values() for name in group} <= set(METHODS)
    assert METHODS["noise_0.05"].noise == 0.05


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "quad_trap", "--seeds", "0"], "--seeds must be a whole number of at least 1, not 0"),
        (["--task", "quad_trap", "--workers", "-1"], "--workers must be a whole number of at least 0, not -1"),
        (["--task", "nowhere"], "nowhere"),
        (["--task", "quad_trap", "--value", "no.safetensors"], "no value 'no.safetensors'"),
        (["--task", "car_ttr"], "task 'car_ttr' has no part 'optimal_control'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, message, capsys, tmp_path):
    with suppress(SystemExit):  # a command line that is refused
        assert train([*arguments, "--folder", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_unknown_method_and_a_value_of_another_task_are_refused(tmp_path):
    with pytest.raises(OcError, match="no method 'sarsa': there are oc_ppo, ppo"):
        OcRun(TASK, "sarsa", 0).model(ROLL_OUT)
    from oc_baseline_node.values.value_file import find_value

    with pytest.raises(ValueFunctionError, match="belongs to task 'car_navigation', not 'quad_trap'"):
        OcRun(TASK, "oc_ppo", 0, find_value("car_navigation")).model(ROLL_OUT)
    changed = own_task(tmp_path, "quad_trap", ("steps: 100", "steps: 90"))
    with pytest.raises(OcError, match="is of another version of 'quad_trap': make it"):
        OcRun(load_navigation_task(changed), "oc_ppo", 0).model(ROLL_OUT)


def test_a_method_without_v_oc_needs_no_file_of_it():
    own = load_navigation_task("car_navigation").model_copy(update={"name": "own"})
    run = OcRun(own, "ppo", 0)
    assert run.description["value_digest"] is None
    assert run.discount == own.optimal_control.discount
    with pytest.raises(OcError, match="no value 'own'"):
        _ = OcRun(own, "oc_ppo", 0).description
    bare = own.model_copy(update={"optimal_control": None})
    with pytest.raises(OcError, match=r"no 'optimal_control\.discount' to learn with"):
        _ = OcRun(bare, "ppo", 0).description


@pytest.mark.parametrize("name", ["car_navigation", "quad_navigation", "quad_trap"])
def test_methods_that_are_compared_have_the_same_discount(name):
    task = load_navigation_task(name)
    assert OcRun(task, "ppo", 0).discount == OcRun(task, "oc_ppo", 0).discount
