"""Walls: none is thinner than a cell, and no path leaks through a valid one, at any position."""

import math
from dataclasses import replace

import numpy as np
import pytest
from games import plane
from hypothesis import example, given, settings
from hypothesis import strategies as st
from ttr_reward_node.problems.obstacles import make_clearance

from ctrl_rl_core import Axis, Box, Disc, Interval, Region, load_navigation_task
from ttr_reward_node import Clearance, TimeToReachError, problem_from_task, solve

AXES = (Axis("x", "m", -2.0, 2.0, 41), Axis("y", "m", -2.0, 2.0, 41))
CELL = 0.1


@settings(max_examples=25, deadline=None, derandomize=True)
@given(angle=st.floats(-0.8, 0.8), shift=st.floats(0.0, 2 * CELL))
@example(angle=math.pi / 4, shift=0.0)
@example(angle=0.0, shift=0.5 * CELL)
def test_a_wall_as_thin_as_is_allowed_holds(angle, shift):
    """The wall divides the plane; the target is 2 cells behind it, within one step of the scheme."""
    thickness = 1.0501 * CELL * (abs(math.cos(angle)) + abs(math.sin(angle)))
    across = np.array([math.cos(angle), math.sin(angle)])
    wall = Box(tuple(shift * across), (thickness, 20.0), angle)
    clearance = make_clearance((wall,), None, AXES, 0.0)
    x, y = (axis.nodes for axis in AXES)
    along = x[:, None] * across[0] + y * across[1] - shift
    middle = (shift - 0.5 * thickness - 3 * CELL) * across
    target = Region({k: Interval(m - CELL, m + CELL) for k, m in zip("xy", middle, strict=True)})
    phi = solve(replace(plane(), target=target, clearance=Clearance((0, 1), clearance))).grid.values
    assert np.isinf(phi[along > 0.0]).all()
    assert np.isfinite(phi[along < -0.5 * thickness - 2 * CELL]).mean() > 0.95


@pytest.mark.parametrize(
    "shape",
    [Box((0.0, 0.0), (1.0, 0.1)), Box((0.0, 0.0), (0.14, 1.0), math.pi / 4), Disc((0.0, 0.0), 0.07)],
)
def test_a_thinner_one_is_refused_unless_widened_or_outside(shape):
    with pytest.raises(TimeToReachError, match=r"m are too thin for cells of 0\.1 m.*: give an inflation of 0\.00"):
        make_clearance((shape,), None, AXES, 0.0)
    assert make_clearance((shape,), None, AXES, 0.01).min() <= 0.0
    assert make_clearance((replace(shape, centre=(9.0, 0.0)),), None, AXES, 0.0).min() > 0.0


def test_all_beyond_the_walls_of_an_arena_is_solid():
    arena = (Interval(-1.03, 1.52), Interval(-1.53, 3.0))
    clearance = make_clearance((), arena, AXES, 0.1)
    x, y = np.meshgrid(*(axis.nodes for axis in AXES), indexing="ij")
    inside = (x > -0.93) & (x < 1.42) & (y > -1.43)
    np.testing.assert_array_equal(clearance > 0.0, inside)
    assert clearance.max() == pytest.approx(1.275 - 0.1, abs=0.05)


def test_thin_walls_of_the_corridor_need_an_inflation():
    with pytest.raises(TimeToReachError, match=r"of 0\.05 m are too thin for cells of 0\.05 m"):
        problem_from_task("curved_corridor")
    task = load_navigation_task("curved_corridor")
    problem = problem_from_task(task, counts={"theta": 36}, inflation=task.robot.radius)
    start = [[0.375, 0.0, 0.0]]
    assert 25.0 < solve(problem).grid.value(start)[0] < 32.0


@pytest.mark.parametrize("task", ["car_ttr", "quad_ttr"])
def test_tasks_in_arenas_need_none(task):
    problem = problem_from_task(task)
    assert problem.clearance is not None
    assert problem.clearance.values.min() < 0.0


@pytest.mark.parametrize("inflation", [-0.1, math.nan, math.inf])
def test_inflation_must_be_a_length(inflation):
    with pytest.raises(TimeToReachError, match=r"inflation .* must be 0 or more"):
        problem_from_task("car_ttr", inflation=inflation)


def test_counts_of_unknown_states_are_refused():
    with pytest.raises(TimeToReachError, match="counts for 'thta'; the states are x, y, theta"):
        problem_from_task("car_ttr", counts={"thta": 16})
