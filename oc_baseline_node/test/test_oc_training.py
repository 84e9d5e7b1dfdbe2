"""Learning with each baseline in the real simulator: resumes exactly, becomes tables and pictures."""

import json

import numpy as np
import pytest
from ctrl_rl_core.tasks import load_navigation_task
from ctrl_rl_training.actor import Actor
from ctrl_rl_training.algorithms import ROLL_OUT
from ctrl_rl_training.run_folder import result_file
from ctrl_rl_training.training import Options, train_one
from oc_baseline_node.errors import OcError
from oc_baseline_node.training.environment import PaidTimeOut
from oc_baseline_node.training.methods import GROUPS, METHODS
from oc_baseline_node.training.results import collect
from oc_baseline_node.training.runs import OcRun, oc_runs
from oc_baseline_node.training.training_cli import train, training_figures
from sim_bridge.environments import NavigationEnv

SHORT = {"iterations": 2, "samples": ROLL_OUT, "evaluations": 1, "final_evaluations": 2}


class CutOffError(Exception):
    """Stands for a kill between two iterations."""


def cut_off(*_):
    """A report that ends the run."""
    raise CutOffError


@pytest.mark.parametrize("method", ["oc_ppo", "oc_trpo", "stein", "q_prop", "noise_0.1", "oc_own_end"])
def test_a_run_that_was_cut_off_ends_as_if_it_had_not_been(tmp_path, method):
    run = OcRun("quad_trap", method, 3)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train_one(run, Options(whole, **SHORT))
    with pytest.raises(CutOffError):
        train_one(run, Options(cut, **SHORT), report=cut_off)
    train_one(run, Options(cut, **SHORT))

    def learnt(folder):
        result = json.loads(result_file(folder, run).read_text(encoding="utf-8"))
        for point in result["curve"]:
            del point["seconds"]
        return result

    assert learnt(cut) == learnt(whole)
    one, other = (Actor.load(folder / run.name / "policy.safetensors") for folder in (whole, cut))
    assert all(np.array_equal(a, b) for a, b in zip(one.weights, other.weights, strict=True))


def test_runs_become_a_table_and_pictures(tmp_path, capsys):
    runs = oc_runs("quad_trap", ("ppo", "oc_ppo", "entropy_0.05"), 2)
    assert [run.method_name for run in runs[:2]] == ["oc_ppo", "oc_ppo"]
    for run in runs:
        train_one(run, Options(tmp_path, **SHORT))
    rows, figures = collect(runs, tmp_path)
    of_trap = next(row for row in rows if (row.method, row.metric) == ("ppo", "trap rate"))
    assert (len(of_trap.values), of_trap.thesis) == (2, 0.65)
    assert np.array(figures["curves"]["ppo"]["total"]).shape == (2, 2)
    assert np.array(figures["advantages"]["oc_ppo"]).shape == (2, 2, 1, 3)
    results = tmp_path / "results.json"
    known = ["--methods", "oc_ppo", "ppo", "entropy_0.05", "--seeds", "2", "--iterations", "2"]
    assert train(["--task", "quad_trap", "--folder", str(tmp_path), *known, "--results", str(results)]) == 0
    assert "PPO, OC baseline" in capsys.readouterr().out
    pictures = tmp_path / "pictures"
    assert training_figures([str(results), "--output", str(pictures)]) == 0
    assert {"quad_trap_oc_ablation.png", "quad_trap_oc_advantages.png", "quad_trap_oc_entropy.png"} < {
        file.name for file in pictures.iterdir()
    }


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
        (["--task", "quad_trap", "--seeds", "0"], "--seeds must be at least 1"),
        (["--task", "nowhere"], "nowhere"),
        (["--task", "quad_trap", "--value", "no.safetensors"], "no value 'no.safetensors'"),
        (["--task", "car_ttr"], "no value 'car_ttr'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, message, capsys, tmp_path):
    assert train([*arguments, "--folder", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_unknown_method_and_a_value_of_another_task_are_refused():
    with pytest.raises(OcError, match="no method 'sarsa': there are oc_ppo, ppo"):
        OcRun("quad_trap", "sarsa", 0).model(ROLL_OUT)
    from oc_baseline_node.value_file import find_value

    with pytest.raises(OcError, match="is not of task 'quad_trap'"):
        OcRun("quad_trap", "oc_ppo", 0, find_value("car_navigation")).model(ROLL_OUT)
