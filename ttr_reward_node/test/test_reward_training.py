"""Training with the rewards of Table 3.3: the wrapper's rewards, and the table and figures of the runs."""

import json
from contextlib import suppress

import gymnasium
import numpy as np
import pytest
from commands import command
from ctrl_rl_learning.sb3 import REWARD_SCALE, FleetEnvironments, Visits
from ctrl_rl_learning.study import RunOptions, samples_to
from ctrl_rl_learning.study import train as train_run
from ttr_reward_node.rewards.progress import PER_SECOND, TimeToReach
from ttr_reward_node.training.cli import plot, train
from ttr_reward_node.training.plots import draw_visits
from ttr_reward_node.training.results import STAGES, collect
from ttr_reward_node.training.training import RewardRun, make_progress, make_rewarded, reward_runs

from ctrl_rl_core import Outcome, load_navigation_task, task_file
from ttr_reward_node import TimeToReachError, load_value, make_reward, problem_from_task, solve

ROLL_OUT = 256


def test_the_wrapper_pays_the_reward_and_leaves_the_rest_alone():
    reward = make_reward("distance_10", load_navigation_task("car_ttr"))
    environment = make_rewarded(reward)
    bare = gymnasium.make("sim_bridge.environments:ctrl_rl/car_ttr-v0", options=environment.unwrapped.world.options)
    scaled, _ = environment.reset(seed=4)
    observation, _ = bare.reset(seed=4)
    action = np.array([1.0, 0.3], dtype=np.float32)
    over = False
    while not over:
        assert scaled == pytest.approx((observation - environment.middle) / environment.unit, abs=1e-5)
        scaled, paid, terminated, truncated, info = environment.step(action)
        observation, own, bare_terminated, bare_truncated, _ = bare.step(action)
        assert (terminated, truncated) == (bare_terminated, bare_truncated)
        over = terminated or truncated
        expected = own if over else reward(info["state"][None], [Outcome.RUNNING])[0]
        assert paid == pytest.approx(expected)
    assert info["outcome"] == "COLLISION"
    environment.close()
    bare.close()


def test_a_fleet_is_paid_what_one_robot_is():
    reward = make_reward("distance_10", load_navigation_task("car_ttr"))
    run = RewardRun("car_ttr", "ppo", "distance_10", 0)
    fleet = run.environments("ppo")
    assert isinstance(fleet, FleetEnvironments)
    fleet.seed(0)
    fleet.reset()
    random, ended = np.random.default_rng(0), set()
    for _ in range(300):
        _, paid, over, infos = fleet.step(random.uniform(-1.0, 1.0, (fleet.num_envs, 2)))
        states = np.array([info["state"] for info in infos])
        outcomes = [Outcome[info["outcome"]] for info in infos]
        np.testing.assert_allclose(paid, REWARD_SCALE * reward(states, outcomes), rtol=1e-5)
        ended |= {outcome for outcome, done in zip(outcomes, over, strict=True) if done}
    assert Outcome.COLLISION in ended
    assert RewardRun("car_ttr", "ppo", "sparse", 0, engine="auto").in_fleet is False


def test_runs_become_a_table_and_pictures(tmp_path, capsys, update_every):
    update_every(ROLL_OUT)
    runs = reward_runs("quad_ttr", ("ppo",), ("sparse", "distance_10"), 2)
    for run in runs:
        train_run(run, RunOptions(tmp_path, 2, ROLL_OUT, 1, 2))
    rows, figures = collect(runs, tmp_path)
    assert [(row.method, row.metric, len(row.values)) for row in rows if row.metric == "success"] == [
        ("ppo, sparse", "success", 2),
        ("ppo, distance_10", "success", 2),
    ]
    assert np.array(figures["curves"]["ppo, sparse"]["success"]).shape == (2, 2)
    assert np.sum(figures["visits"]["ppo, sparse"]["turns"]) == 2 * 2 * ROLL_OUT
    results = tmp_path / "results.json"
    known = ["--rewards", "sparse", "distance_10", "--algorithms", "ppo", "--seeds", "2", "--iterations", "2"]
    assert train(["--task", "quad_ttr", "--folder", str(tmp_path), *known, "--results", str(results)]) == 0
    assert json.loads(results.read_text(encoding="utf-8"))["figures"]["task"] == "quad_ttr"
    assert plot([str(results), "--output", str(tmp_path / "pictures")]) == 0
    assert sorted(file.name for file in (tmp_path / "pictures").iterdir()) == [
        "quad_ttr_success.svg",
        "quad_ttr_turns.svg",
        "quad_ttr_visits.png",
    ]
    assert "ppo, sparse" in capsys.readouterr().out
    policy = tmp_path / runs[0].name / "policy.safetensors"
    answer = command("evaluate", policy, "--episodes", 2, package="ttr_reward_node")
    assert "episodes   2 of quad_ttr, from seed 0" in answer.stdout, answer.stderr


def test_visits_of_a_corridor_are_drawn_as_well(tmp_path):
    task = load_navigation_task("curved_corridor")
    visits = Visits(task)
    visits.add([np.array([x, 0.0, 0.1]) for x in np.linspace(0.1, 2.0, 20)])
    visits.end_iteration()
    counts = {name: [part.sum(axis=0).tolist()] * STAGES for name, part in visits.counts().items()}
    assert np.sum(counts["places"][0]) == 20
    picture = tmp_path / "visits.png"
    draw_visits({"task": task.name, "visits": {"ppo, ttr": counts}}, task, "ppo", picture)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_learnt_means_good_twice():
    curve = [{"samples": 10 * k, "evaluation": success} for k, success in enumerate((0.0, 0.95, 0.5, 0.9, 1.0), 1)]
    assert samples_to(curve) == 40.0
    assert samples_to(curve[:3]) is None


def test_what_matters_most_is_learnt_first():
    runs = reward_runs("car_ttr", grid="some.safetensors")
    assert len(runs) == 3 * 7 * 5
    assert [{run.reward for run in runs[first : first + 15]} for first in (0, 15)] == [{"ttr_progress"}, {"ttr"}]
    assert {run.grid for run in runs[30:]} == {None}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "car_ttr"], "the reward ttr_progress needs --grid: make it with `solve --task car_ttr`"),
        (["--task", "car_ttr", "--rewards", "sparse", "--seeds", "0"], "--seeds must be a whole number of at least 1"),
        (["--task", "nowhere", "--rewards", "sparse"], "nowhere"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(arguments, message, capsys, tmp_path):
    with suppress(SystemExit):  # an invalid command line
        assert train([*arguments, "--folder", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("content", ["[]", '{"figures": 1}', '{"figures": {"task": "quad_trap", "curves": {}}}'])
def test_figures_of_another_file_are_refused(tmp_path, capsys, content):
    file = tmp_path / "results.json"
    file.write_text(content, encoding="utf-8")
    assert plot([str(file)]) == 1
    assert "is not a file that `train --results` wrote" in capsys.readouterr().err


def test_a_task_file_goes_by_the_tasks_name(tmp_path):
    file = tmp_path / "quad_ttr.yaml"
    file.write_text(task_file("quad_ttr").read_text(encoding="utf-8"), encoding="utf-8")
    run, same = (RewardRun(str(name), "ppo", "sparse", 0) for name in (file, "quad_ttr"))
    assert (run.name, run.description) == (same.name, same.description)


def test_a_run_with_time_to_reach_but_no_grid_is_refused():
    with pytest.raises(TimeToReachError, match="solve the task first"):
        RewardRun("car_ttr", "ppo", "ttr", 0).environment()


def test_progress_pays_the_seconds_gained_and_an_end_what_the_task_says(tmp_path):
    task = load_navigation_task("car_ttr")
    problem = problem_from_task(task, counts=dict.fromkeys(task.grid, 15), inflation=task.robot.radius)
    solve(problem).grid.save(tmp_path / "value.safetensors")
    value = load_value(tmp_path / "value.safetensors")
    environment, potential = make_progress(task, value), TimeToReach(value)
    _, info = environment.reset(seed=4)
    least, over = potential.times(info["state"][None])[0], False
    while not over:
        _, paid, terminated, truncated, info = environment.step(np.array([1.0, 0.3], dtype=np.float32))
        over = terminated or truncated
        before, least = least, min(least, potential.times(info["state"][None])[0])
        assert paid == pytest.approx(PER_SECOND * (before - least) + (-400.0 if over else 0.0))
    assert info["outcome"] == "COLLISION"
    environment.close()


def test_progress_without_a_time_to_reach_is_refused():
    with pytest.raises(TimeToReachError, match="'ttr_progress' needs the task's time to reach"):
        RewardRun("car_ttr", "ppo", "ttr_progress", 0).environment()
