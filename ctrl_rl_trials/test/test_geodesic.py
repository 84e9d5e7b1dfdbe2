"""Time along the shortest path: straight in the open, round corners, and none where no path is left."""

import numpy as np
import pytest
from ctrl_rl_trials.ladder.runs import ladder_runs
from ctrl_rl_trials.ladder.task_list import load_ladder_task
from ctrl_rl_trials.shaping.geodesic import GeodesicInSeconds, _path_lengths
from scipy.ndimage import distance_transform_edt

FREE = np.ones((61, 41), dtype=bool)
SPACINGS = np.array([0.1, 0.1])


def one(*node: int) -> np.ndarray:
    """Return flags of one node."""
    flags = np.zeros_like(FREE)
    flags[node] = True
    return flags


def test_a_free_way_is_straight() -> None:
    goal = one(30, 20)
    exact = 0.1 * distance_transform_edt(~goal)
    found = _path_lengths(FREE, goal, SPACINGS)
    assert np.all(found >= exact - 1e-9)
    assert np.all(found <= 1.028 * exact)


def test_a_way_round_the_end_of_a_wall() -> None:
    free = FREE.copy()
    free[30, :31] = False  # the way leads over node (30, 31)
    found = _path_lengths(free, one(40, 20), SPACINGS)
    exact = 0.1 * (np.hypot(10, 11) + np.hypot(15, 11))
    assert found[15, 20] == pytest.approx(exact, rel=0.04)
    assert found[15, 20] >= exact - 0.02


def test_no_way_through_a_wall_one_node_thick_or_past_touching_corners() -> None:
    straight, diagonal = FREE.copy(), FREE.copy()
    straight[30] = False
    rows = np.arange(10, 51)
    diagonal[rows, rows - 10] = False
    assert np.isinf(_path_lengths(straight, one(40, 20), SPACINGS)[:30]).all()
    assert np.isinf(_path_lengths(diagonal, one(40, 20), SPACINGS)[20, 30])


def test_a_ladder_task_has_the_longer_way_behind_its_wall() -> None:
    task = load_ladder_task("practice_corner")
    potential = GeodesicInSeconds(task)
    before, behind = potential.times(np.array([[0.3, 0.5, 0.0], [0.9, 0.5, 0.8]]))
    assert behind < 4.0 < before < potential.longest


def test_a_run_is_paid_for_coming_nearer_along_the_path() -> None:
    (run,) = ladder_runs(["practice_corner"], ["best_progress_geodesic"], ["ppo"], 1, {"practice_corner": None})  # type: ignore[dict-item]
    reward = run.fleet_reward(1)
    assert reward is not None
    states = np.array([[1.4, -1.0, 1.57]])
    reward.begin([0], states)
    paid = reward.pay(states + np.array([0.0, 0.5, 0.0]), np.zeros(1, dtype=np.intp), np.zeros(1))
    assert paid[0] > 0.0
