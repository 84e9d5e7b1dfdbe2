"""MPC's time to go: near the time to reach, solved once, and learnt with."""

import numpy as np
import pytest
from ctrl_rl_trials.ladder.runs import ladder_runs
from ctrl_rl_trials.ladder.task_list import load_ladder_task
from ctrl_rl_trials.shaping import time_to_go
from ctrl_rl_trials.shaping.time_to_go import TimeToGo, find_or_solve_trajectories

from ctrl_rl_core import NavigationTask
from oc_baseline_node import OcError
from ttr_reward_node import TimeToReach, problem_from_task, solve

TASK = load_ladder_task("practice_corner")


@pytest.fixture(scope="module", autouse=True)
def _few_trajectories():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_to_go, "TRAJECTORIES", 40)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a few trajectories round the practice corner."""
    return find_or_solve_trajectories(TASK, tmp_path_factory.mktemp("values"))


@pytest.fixture(scope="module")
def potential(folder):
    return TimeToGo(folder, TASK)


def draw(task: NavigationTask, count: int) -> np.ndarray:
    random, names = np.random.default_rng(0), task.system.build().state_names
    return np.array([task.start.region.sample(names, random) for _ in range(count)])


def test_it_is_near_the_time_to_reach(potential):
    """Within a second on average, where starts are some 9 s away, though there are only forty trajectories."""
    problem = problem_from_task(TASK, counts={"x": 41, "y": 41, "theta": 36}, inflation=TASK.robot.radius)
    exact = TimeToReach(solve(problem).grid)
    states = draw(TASK, 100)
    error = potential.times(states) - exact.times(states)
    assert np.abs(error).mean() < 1.0


def test_it_does_not_see_through_a_wall(potential):
    """On both sides of a wall 0.2 m thick: the goal is near on one, and far on the other."""
    before, behind = potential.times(np.array([[0.3, 0.5, 0.0], [0.9, 0.5, 0.8]]))
    assert behind < 4.0
    assert before > 7.0


def test_an_obstacle_has_no_way_and_the_goal_is_there(potential):
    goal, obstacle = potential.times(np.array([[1.6, 1.4, 0.0], [0.6, -0.3, 0.0]]))
    assert goal < 1.0
    assert np.isinf(obstacle)


def test_trajectories_are_solved_once(folder):
    before = {file: file.stat().st_mtime_ns for file in folder.glob("chunk-*")}
    assert find_or_solve_trajectories(TASK, folder.parent) == folder
    assert {file: file.stat().st_mtime_ns for file in folder.glob("chunk-*")} == before


def test_trajectories_of_another_task_are_refused(folder):
    with pytest.raises(OcError, match="give another folder"):
        TimeToGo(folder, load_ladder_task("open_field"))


def test_a_run_learns_with_it_and_names_it(folder, potential):
    (run,) = ladder_runs(["practice_corner"], ["best_progress_mpc"], ["ppo"], 1, {}, {"practice_corner": folder})
    assert run.description["value_digest"] == potential.digest
    reward = run.fleet_reward(1)
    states = np.array([[1.4, -1.0, 1.57]])
    reward.begin([0], states)
    paid = reward.pay(states + np.array([0.0, 0.5, 0.0]), np.zeros(1, dtype=np.intp), np.zeros(1))
    assert paid[0] > 0.0
