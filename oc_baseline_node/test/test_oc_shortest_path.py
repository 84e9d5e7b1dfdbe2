"""Initial guesses for solvers: paths around obstacles, and their benefit."""

from dataclasses import replace

import numpy as np
import pytest
from oc_baseline_node.mpc.initial_guess import InitialGuesses, ShortestPathPlanner, braking_guess

from ctrl_rl_core import Region, load_navigation_task, make_system
from oc_baseline_node import Mpc, draw_start, formulate

TASKS = ("car_navigation", "quad_navigation", "quad_trap")


@pytest.mark.parametrize("name", TASKS)
def test_a_way_leads_from_anywhere_to_the_goal_and_keeps_clear(name):
    problem = formulate(load_navigation_task(name))
    planner, random, goal = ShortestPathPlanner(problem), np.random.default_rng(1), np.array(problem.goal)
    states = np.zeros((141, len(problem.system.states)))
    for _ in range(100):
        position = draw_start(problem, random)[problem.positions]
        way = planner.path(position, 141)
        np.testing.assert_allclose(way[[0, -1]], [position, goal], atol=1e-9)
        states[:, problem.positions] = way
        # Between two nodes it may cut a corner by less than their distance.
        assert problem.margin(states).min() > -0.1
        length, straight = np.hypot(*np.diff(way, axis=0).T).sum(), np.hypot(*(goal - position))
        assert length >= straight - 1e-9
        if planner.is_straight(position):
            assert length < 1.1 * straight + 0.4


def test_a_guess_goes_round_only_where_it_must():
    problem = formulate(load_navigation_task("quad_navigation"))
    guesses = InitialGuesses(problem)
    under_the_box, beside_it = np.zeros(6), np.zeros(6)
    under_the_box[[0, 2]], beside_it[[0, 2]] = (3.75, 2.0), (1.0, 6.5)
    assert len(guesses(under_the_box)) == 2
    assert len(guesses(beside_it)) == 1
    states, controls = guesses(under_the_box)[0]
    assert states.shape == (141, 6)
    assert controls.shape == (140, 2)
    assert states[:, 0].min() < 2.0  # left of the box


def test_a_car_that_faces_away_turns_for_a_long_way_and_backs_up_for_a_short_one():
    problem = formulate(load_navigation_task("car_navigation"), "free_time")
    problem = replace(
        problem, system=make_system("dubins_car", control_bounds={"v": (-0.2, 0.6), "omega": (-1.0, 1.0)})
    )
    guesses, goal = InitialGuesses(replace(problem, obstacles=())), np.array(problem.goal)
    for distance, turned in ((4.0, np.pi), (0.5, 0.0)):
        states, _ = guesses(np.array([*(goal - [distance, 0.0]), np.pi]))[0]
        assert abs(states[-1, 2] - states[0, 2]) == pytest.approx(turned, abs=1e-6)


@pytest.mark.parametrize("name", TASKS)
def test_nearly_every_start_of_an_episode_has_a_trajectory(name):
    task = load_navigation_task(name)
    problem, random = formulate(task), np.random.default_rng(0)
    mpc = Mpc(problem)
    starts = [task.start.region.sample(problem.system.state_names, random) for _ in range(12)]
    assert sum(mpc.solve(start).solved for start in starts) >= 11


def test_who_hovers_under_a_box_is_not_doomed():
    problem = formulate(load_navigation_task("quad_navigation"))
    clear = replace(problem, horizon=20, terminal=Region(), gamma=1.0, state_weight=0.0, trap_weight=0.0)
    hovering, diving = np.zeros(6), np.zeros(6)
    hovering[[0, 2]], diving[[0, 2, 3]] = (3.6, 2.0), (3.6, 1.0, -8.0)
    mpc = Mpc(clear)
    assert mpc.solve(hovering, braking_guess(clear, hovering)).solved
    assert not mpc.solve(diving, braking_guess(clear, diving)).solved
