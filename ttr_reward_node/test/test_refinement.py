"""Solving on a finer grid than requested: for which problems, and which values are kept."""

import numpy as np
import pytest
from games import double_integrator, line, plane
from ttr_reward_node.solvers.refinement import choose_refinement, coarsen, refine

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import TimeToReachError, TimeToReachProblem, problem_from_task, solve


def pendulum(count=61):
    states = Quantity("a", "rad", -np.pi, np.pi, periodic=True), Quantity("w", "rad/s")
    system = System(
        name="pendulum",
        states=states,
        controls=(Quantity("torque", "1", -0.5, 0.5),),
        disturbances=(Quantity("d_a", "rad/s", 0.0, 0.0), Quantity("d_w", "rad/s^2", 0.0, 0.0)),
        parameters={},
        equations=lambda math, _p: lambda x, u, _d: (x[1], math.sin(x[0]) + u[0]),
    )
    axes = Axis("a", "rad", -np.pi, np.pi, count, True), Axis("w", "rad/s", -3.0, 3.0, count)
    return TimeToReachProblem(system, axes, Region({"a": Interval(-0.2, 0.2), "w": Interval(-0.3, 0.3)}))


@pytest.mark.parametrize("finer", [2, 3, 4])
@pytest.mark.parametrize("make", [double_integrator, pendulum])
def test_every_node_stays_one(make, finer):
    problem = make()
    fine = refine(problem, finer)
    for axis, split in zip(problem.axes, fine.axes, strict=True):
        np.testing.assert_allclose(split.nodes[::finer], axis.nodes, atol=1e-12)
    numbers = np.arange(fine.points, dtype=np.float32).reshape(fine.counts)
    assert coarsen(numbers, problem.axes, finer).shape == problem.counts


def test_obstacles_stay_where_they_are():
    problem = plane(lambda x, y: np.hypot(x, y) - 0.5)
    fine = refine(problem, 4)
    np.testing.assert_allclose(fine.clearance.values[::4, ::4], problem.clearance.values, atol=1e-6)
    np.testing.assert_allclose(
        fine.clearance.values[2::4, ::4],
        0.5 * (problem.clearance.values[1:] + problem.clearance.values[:-1]),
        atol=1e-6,
    )


def test_finer_cells_are_more_exact():
    """x'' = u to |x| <= 1/2 at any speed, from rest: the time is sqrt(2 (|x| - 1/2))."""
    x = np.linspace(-2.5, -1.0, 20)
    exact = np.sqrt(2.0 * (np.abs(x) - 0.5))
    states = np.stack((x, np.zeros_like(x)), axis=-1)
    errors = [np.abs(solve(double_integrator(), finer=k).grid.value(states) - exact).mean() for k in (1, 4)]
    assert errors[1] < 0.7 * errors[0]


def test_only_a_plane_is_split_and_a_large_one_less():
    assert choose_refinement(line()) == 1
    assert choose_refinement(double_integrator()) == 4
    assert choose_refinement(double_integrator(count=2001)) == 1
    assert choose_refinement(problem_from_task("car_ttr")) == 1


def test_a_number_of_cells_below_one_is_refused():
    with pytest.raises(TimeToReachError, match="take 1 or more"):
        solve(line(), finer=0)
