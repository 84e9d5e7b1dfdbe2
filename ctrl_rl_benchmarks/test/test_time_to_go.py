"""MPC's time to go: near the time to reach, made once, taken up where it was cut off, and learnt with."""

import os

import numpy as np
import pytest
from ctrl_rl_benchmarks.experiments.runs import ladder_runs
from ctrl_rl_benchmarks.ladder.task_list import load_ladder_task
from ctrl_rl_benchmarks.ways import time_to_go
from ctrl_rl_benchmarks.ways.time_to_go import TimeToGo, find_or_fit, mpc_task
from ttr_reward_node.rewards.progress import TimeToReach

from ctrl_rl_core import task_digest
from ttr_reward_node import problem_from_task, solve

TASK = load_ladder_task("open_field")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Return the file of the open field's time to go, of few trajectories."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_to_go, "TRAJECTORIES", 20)
        yield find_or_fit(TASK, tmp_path_factory.mktemp("values"))


def test_it_is_near_the_time_to_reach(file):
    """Within a second on average, where starts are 9.7 s away, though there are only twenty trajectories."""
    problem = problem_from_task(TASK, counts={"x": 41, "y": 41, "theta": 36}, inflation=TASK.robot.radius)
    exact = TimeToReach(solve(problem).grid)
    potential, random = TimeToGo(file, TASK), np.random.default_rng(0)
    names = TASK.system.build().state_names
    states = np.array([TASK.start.region.sample(names, random) for _ in range(100)])
    error = potential.times(states) - exact.times(states)
    assert np.abs(error).mean() < 1.0


def test_a_collision_has_no_way_and_the_goal_is_there(file):
    potential = TimeToGo(file, TASK)
    goal, wall, beyond = potential.times(np.array([[2.2, 2.2, 0.0], [0.0, -2.95, 0.0], [0.0, -9.0, 0.0]]))
    assert 0.0 <= goal < 1.0
    assert np.isinf((wall, beyond)).all()


def test_a_file_is_made_once(file):
    before = os.stat(file).st_mtime_ns
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_to_go, "TRAJECTORIES", 20)
        assert find_or_fit(TASK, file.parent) == file
    assert os.stat(file).st_mtime_ns == before


def test_the_task_itself_stays_as_it_is():
    digest = task_digest(TASK)
    assert task_digest(mpc_task(TASK)) != digest
    assert task_digest(TASK) == digest


def test_a_run_learns_with_it_and_names_it(file):
    (run,) = ladder_runs(["open_field"], ["best_progress_mpc"], ["ppo"], 1, {}, {"open_field": file})
    assert run.description["value_digest"] == TimeToGo(file, TASK).digest
    reward = run._reward(2)
    states = np.array([[-2.0, -2.0, 0.8], [0.0, 0.0, 0.8]])
    reward.begin([0, 1], states)
    paid = reward.pay(states + np.array([0.2, 0.2, 0.0]), np.zeros(2, dtype=np.intp), np.zeros(2))
    assert (paid > 0.0).all()
