"""General properties: unreachable states, obstacles, periodic axes, termination, all systems of Table 3.1."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from games import double_integrator, line, plane
from ttr_reward_node.verification.cost import CASES, exponent, make_problem, measure_cost

from ctrl_rl_core import Interval, Region
from ttr_reward_node import METHODS, TimeToReachError, problem_from_task, solve


def wall(gap):
    """Return the distance to a wall at x = 0.5 from y = -2 to 2 - gap."""
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
    """Rotating the plane by half a turn rotates the solution; the target then lies across the seam of the axis."""
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


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance": 0.0}, "tolerance 0 s"),
        ({"tolerance": -1.0}, "tolerance -1 s"),
        ({"tolerance": np.nan}, "tolerance nan s"),
        ({"max_sweeps": 0}, "0 sweeps"),
    ],
)
def test_limits_must_be_positive(options, words):
    with pytest.raises(TimeToReachError, match=words):
        solve(line(), **options)


@pytest.mark.parametrize("sweeps", [1, 2, 4])
def test_what_is_given_up_holds_no_made_up_times(sweeps):
    """The longest time of the car is 20 s; before convergence, interpolation blur alone produces hours."""
    solution = solve(problem_from_task("car_ttr", counts=(51, 51, 36)), max_sweeps=sweeps)
    assert not solution.converged
    assert solution.grid.values[np.isfinite(solution.grid.values)].max() < 40.0


def test_a_file_says_how_it_was_solved():
    corridor = solve(problem_from_task("curved_corridor", counts=(55, 34, 18), inflation=0.123, width=0.75)).grid
    assert corridor.notes["inflation"] == "0.123"
    assert corridor.notes["corridor_width"] == "0.75"
    open_ = solve(problem_from_task("car_ttr", counts=(31, 31, 24))).grid
    assert open_.notes["inflation"] == "0.0"
    assert "corridor_width" not in open_.notes


_PIECES = """
import numpy as np
from ttr_reward_node.solvers.decomposition import PLANAR_QUADROTOR_FIVE, split
from ttr_reward_node.problems.from_task import problem_from_task
from ttr_reward_node.solvers.solver import solve
problem = problem_from_task("quad_ttr", counts={"psi": 31, "v_x": 21, "omega": 9})
for part in split(problem, PLANAR_QUADROTOR_FIVE):
    if part.problem.system.state_names in (("omega",), ("v_x", "psi")):
        solution = solve(part.problem, "lax_friedrichs")
        print(solution.converged, np.isnan(solution.grid.values).any())
"""


def test_lax_friedrichs_stays_within_its_arrays(tmp_path):
    """If f depends on every state there is a dummy axis of one node without neighbours."""
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", _PIECES], env=environment, check=False, capture_output=True, text=True)
    assert run.stdout.split() == ["True", "False"] * 2, run.stderr
