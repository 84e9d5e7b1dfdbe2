"""What holds for any problem: unreachable states, obstacles, periodic axes, when it stops, all systems of Table 3.1."""

from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_core.regions import Region
from ctrl_rl_core.units import Interval
from games import double_integrator, line, plane
from ttr_reward_node.cost import CASES, exponent, make_problem, measure_cost
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problem import problem_from_task
from ttr_reward_node.solver import METHODS, solve


def wall(gap):
    """A wall at x = 0.5 from y = -2 to 2 - gap."""
    return lambda x, y: np.maximum(np.abs(x - 0.5) - 0.15, y - (2.0 - gap))


@pytest.mark.parametrize("method", METHODS)
def test_behind_a_closed_wall_all_is_infinite(method):
    problem = plane(wall(gap=-1.0))
    phi = solve(problem, method).grid.values
    x = problem.axes[0].nodes
    assert np.isinf(phi[x > 0.45]).all()
    assert np.isfinite(phi[x < 0.25]).all()
    assert phi[x < 0.25].max() < 5.0


@pytest.mark.parametrize("method", METHODS)
def test_round_a_wall_takes_longer(method):
    phi = solve(plane(wall(gap=1.0)), method).grid.values
    free = solve(plane(), method).grid.values
    there = np.isfinite(phi)
    assert there[-1].all()
    assert (phi[there] >= free[there] - 0.05).all()
    assert phi[-1, 0] > free[-1, 0] + 1.0


def test_car_that_must_leave_the_grid_is_unreachable():
    problem = replace(problem_from_task("car_ttr", counts=(51, 51, 36)), clearance=None)
    grid = solve(problem).grid
    out = [[4.9, 0.0, 0.0], [-4.9, 0.0, np.pi - 0.1], [0.0, -4.9, -np.pi / 2]]
    assert np.isinf(grid.value(out)).all()
    assert np.isfinite(grid.value([[4.9, 0.0, np.pi / 2 + 0.2], [0.0, 0.0, 0.0]])).all()
    finite = grid.values[np.isfinite(grid.values)]
    assert finite.max() < 25.0


def test_heading_wraps_round():
    """Turning the whole plane by half a turn turns the solution; the target then lies across the seam of the axis."""
    car = problem_from_task("car_ttr", counts=(51, 51, 36))
    ahead = Region({"x": Interval(1.0, 2.0), "y": Interval(-0.5, 0.5), "theta": Interval(-0.3, 0.3)})
    turned = Region({"x": Interval(-2.0, -1.0), "y": Interval(-0.5, 0.5), "theta": Interval(np.pi - 0.3, np.pi + 0.3)})
    one = solve(replace(car, clearance=None, target=ahead)).grid
    other = solve(replace(car, clearance=None, target=turned)).grid
    states = np.random.default_rng(0).uniform([-4, -4, -np.pi], [4, 4, np.pi], (2000, 3))
    opposite = states * [-1.0, -1.0, 1.0]
    opposite[:, 2] = np.mod(states[:, 2] + 2.0 * np.pi, 2.0 * np.pi) - np.pi
    a, b = one.value(states), other.value(opposite)
    assert np.mean(np.isfinite(a) != np.isfinite(b)) < 0.01
    both = np.isfinite(a) & np.isfinite(b)
    difference = np.abs(a[both] - b[both])
    assert np.median(difference) < 1e-3
    assert np.quantile(difference, 0.95) < 0.05


def test_giving_up_is_said():
    solution = solve(double_integrator(), max_sweeps=3)
    assert not solution.converged
    assert solution.sweeps == 3
    assert solution.grid.notes["converged"] == "no"


@pytest.mark.parametrize("method", METHODS)
def test_stops_at_the_tolerance_and_tells_each_sweep(method):
    told = []
    solution = solve(double_integrator(), method, tolerance=1e-3, progress=lambda *args: told.append(args))
    assert solution.converged
    assert solution.residual <= 1e-3
    assert told[-1] == (solution.sweeps, solution.residual)
    assert [number for number, _ in told] == list(range(1, solution.sweeps + 1))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_every_system_is_solved(name, method):
    solution = solve(make_problem(name, 1e4), method)
    assert solution.converged
    assert solution.reachable > 0.01
    assert not np.isnan(solution.grid.values).any()
    assert (solution.grid.values >= 0.0).all()


def test_cost_rows():
    rows = measure_cost(("3D Dubins car",), (1e3, 1e4, 3e4))
    assert [row["dimension"] for row in rows] == [3, 3, 3]
    assert [row["points"] for row in rows] == sorted(row["points"] for row in rows)
    assert np.isfinite(exponent(rows, least=0.0))


def test_unknown_method():
    with pytest.raises(TimeToReachError, match="semi_lagrangian"):
        solve(line(), "level_set")
