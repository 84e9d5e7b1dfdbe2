"""Accuracy against exact Dubins paths on the full grid, and against closed forms for smaller systems."""

from dataclasses import replace

import numpy as np
import pytest
from games import line, plane
from ttr_reward_node.verification.convergence import convergence_table, measure_errors
from ttr_reward_node.verification.exact_times import reference

from ttr_reward_node import TimeToReachError, problem_from_task, solve


@pytest.fixture(scope="module")
def car():
    return replace(problem_from_task("car_ttr", counts=(101, 101, 72)), clearance=None)


def test_dubins_car_against_exact_paths(car):
    solution = solve(car)
    exact = reference(car, 1500)
    errors = measure_errors(solution.grid.value(exact.states), exact.times)
    assert solution.converged
    assert len(exact.times) == 1500
    assert errors["median_s"] <= 0.02
    assert errors["mean_relative"] <= 0.015
    assert errors["missed"] <= 0.005
    assert abs(errors["bias_s"]) <= 0.02


def test_both_methods_converge_to_the_same_function():
    rows = convergence_table(counts=((26, 26, 18), (51, 51, 36), (76, 76, 54)), states=400)
    assert all(row["converged"] for row in rows)
    for method in ("semi_lagrangian", "lax_friedrichs"):
        error = [row["mean_s"] for row in rows if row["method"] == method]
        assert error[0] > error[1] > error[2]
    to_best = [row["mean_to_best_s"] for row in rows if row["method"] == "lax_friedrichs"]
    assert to_best[0] > to_best[1] > to_best[2]
    last = {row["method"]: row["mean_s"] for row in rows[-2:]}
    assert last["semi_lagrangian"] < 0.25 * last["lax_friedrichs"]


@pytest.mark.parametrize("shift", [0.0, 0.013, 0.05, 0.077])
def test_target_between_nodes_is_met_exactly(shift):
    """Shifting the target by a fraction of a cell (0.1 m) shifts the values by the same amount."""
    problem = line(centre=shift)
    x = problem.axes[0].nodes
    expected = np.maximum(np.abs(x - shift) - 0.25, 0.0)
    np.testing.assert_allclose(solve(problem).grid.values, expected, atol=2e-4)


def test_plane_is_the_largest_distance_along_an_axis():
    problem = plane()
    x, y = np.meshgrid(problem.axes[0].nodes, problem.axes[1].nodes, indexing="ij")
    expected = np.maximum(np.maximum(np.abs(x + 1.4), np.abs(y)) - 0.2, 0.0)
    np.testing.assert_allclose(solve(problem).grid.values, expected, atol=2e-2)


def test_reference_refuses_what_it_does_not_know():
    with pytest.raises(TimeToReachError, match="Dubins car"):
        reference(line())
