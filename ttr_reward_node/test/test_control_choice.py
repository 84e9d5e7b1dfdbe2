"""Number of control samples: enough if the best control lies inside its bounds, few otherwise."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_equations import axes, problem, system
from ttr_reward_node.cli.values import solve_value
from ttr_reward_node.problems.control_choice import MOST_SAMPLES

from ctrl_rl_core import SYSTEM_MODELS, Axis, Disc, Quantity, Region, make_system
from ttr_reward_node import TimeToReachError, TimeToReachProblem, load_value, problem_from_task, solve

TURN = Quantity("heading", "rad", -math.pi, math.pi)


def boat(**options):
    """Return Zermelo's boat: speed 1, heading as control, and a current of 0.5 along x."""
    own = system(lambda m, _x, u, _d: (m.cos(u[0]) + 0.5, m.sin(u[0])), states="xy")
    own = replace(own, controls=(TURN,))
    return TimeToReachProblem(own, axes("xy", 41), Region({}, Disc((0.0, 0.0), 0.25)), **options)


def exact(x, y, current=0.5, radius=0.25):
    """Return the boat's time to the disc: when the disc, carried back by the current, comes within reach."""
    times = np.linspace(0.0, 20.0, 200_001)
    return times[np.argmax(np.hypot(x + current * times, y) <= times + radius)]


def test_systems_that_are_affine_have_three_samples():
    assert problem_from_task("car_ttr").control_counts == 3
    for model in SYSTEM_MODELS:
        states = make_system(model).states
        grid = tuple(
            Axis(s.name, s.unit, *((s.lower, s.upper) if s.periodic else (-1.0, 1.0)), 8, s.periodic) for s in states
        )
        assert TimeToReachProblem(make_system(model), grid, Region({})).control_counts == 3


def test_a_heading_is_sampled_round_the_turn():
    chosen = boat()
    assert chosen.control_counts == (33,)
    headings = chosen.control_samples[:, 0]
    assert len(headings) == 32  # both ends of the full turn are the same heading
    np.testing.assert_allclose(np.diff(headings), math.pi / 16)
    assert chosen.control_doubt == ""
    starts = np.array([[0.0, -1.5], [1.5, 0.0], [-1.5, 0.5], [1.0, 1.0]])
    expected = [exact(*start) for start in starts]
    np.testing.assert_allclose(solve(chosen).grid.value(starts), expected, rtol=0.04)


def test_the_best_control_inside_its_bounds_is_found():
    """x' = u^3 - u has the maximum 2 / sqrt(27) at u = -1 / sqrt(3)."""
    cubic = problem(system(lambda _m, _x, u, _d: (u[0] ** 3 - u[0],), states="x"), count=81)
    assert np.abs(cubic.system.dynamics([0.0], cubic.control_samples)).max() == pytest.approx(2 / 27**0.5, rel=0.01)
    assert solve(cubic).grid.value([[1.8]])[0] == pytest.approx(1.5 * 27**0.5 / 2, rel=0.02)


def test_samples_go_to_the_control_that_needs_them():
    own = system(lambda m, _x, u, _d: (u[0] * m.cos(u[1]), u[0] * m.sin(u[1])), states="xy")
    own = replace(own, controls=(Quantity("v", "m/s", 0.0, 1.0), TURN))
    assert problem(own).control_counts == (3, 33)


def test_a_spike_between_the_samples_is_found():
    spike = problem(system(lambda m, _x, u, _d: (m.exp(-1e4 * (u[0] - 0.3) ** 2),), states="x"))
    assert spike.system.dynamics([0.0], spike.control_samples).max() == pytest.approx(1.0, rel=0.01)


def test_what_cannot_be_sampled_within_reason_is_doubted():
    """Three angles that span all directions in four dimensions, against a strong current, need thousands of samples."""
    angles = tuple(replace(TURN, name=name) for name in "abc")

    def f(m, _x, u, _d):
        xy, yz, zw = ((m.cos(angle), m.sin(angle)) for angle in u)
        return xy[0] * yz[0] * zw[0] + 0.95, xy[1] * yz[0] * zw[0], yz[1] * zw[0], zw[1]

    pointing = problem(replace(system(f, states="wxyz"), controls=angles), count=9)
    assert len(pointing.control_samples) == MOST_SAMPLES
    assert "solve with more, such as --controls a=33 b=33 c=33" in pointing.control_doubt


@pytest.mark.parametrize("current", [0.0, 0.5, 0.9, 0.98])
def test_controls_are_added_where_little_way_is_made(current):
    """Against a current of 0.98, 80 headings and pitches miss most of a submarine's ground speed."""
    elevation = Quantity("up", "rad", -math.pi / 2, math.pi / 2)

    def f(m, _x, u, _d):
        return m.cos(u[0]) * m.cos(u[1]) + current, m.sin(u[0]) * m.cos(u[1]), m.sin(u[1])

    submarine = problem(replace(system(f, states="xyz"), controls=(TURN, elevation)))
    assert len(submarine.control_samples) <= MOST_SAMPLES
    assert submarine.control_doubt == ""
    velocities = submarine.system.dynamics(np.zeros(3), submarine.control_samples)
    random = np.random.default_rng(0).normal(size=(500, 3))
    for direction in random / np.linalg.norm(random, axis=1, keepdims=True):
        speed = 1.0 + current * direction[0]
        assert (velocities @ direction).max() >= 0.94 * speed

    even = replace(submarine, more_controls=())
    assert "of the possible speed: solve with more, such as --controls" in even.control_doubt


def test_numbers_that_are_asked_for_are_kept_and_doubted():
    few = boat(control_counts=5)
    assert few.control_counts == 5
    assert len(few.control_samples) == 4
    assert "miss up to" in few.control_doubt
    with pytest.raises(TimeToReachError, match="control_counts are 1: give a whole number from 2 on"):
        boat(control_counts=1)
    with pytest.raises(TimeToReachError, match="one for each of the controls: heading"):
        boat(control_counts=(3, 3))


def test_the_command_takes_numbers_of_samples(tmp_path, capsys):
    file = str(tmp_path / "car.safetensors")
    coarse = ["--task", "car_ttr", "--count", "x=21", "y=21", "theta=16", "--robot-size", "--output", file]
    assert solve_value([*coarse, "--controls", "omega=5"]) == 0
    assert load_value(file).task == "car_ttr"
    assert problem_from_task("car_ttr", control_counts={"omega": 5}).control_counts == (3, 5)
    assert solve_value([*coarse, "--overwrite", "--controls", "turn=5"]) == 1
    assert "dubins_car has no control 'turn'; there are v, omega" in capsys.readouterr().err
    assert solve_value([*coarse, "--overwrite", "--controls", "omega=1"]) == 1
    assert "give a whole number from 2 on" in capsys.readouterr().err
