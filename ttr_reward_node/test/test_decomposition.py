"""Decomposed systems: free names, joining by the maximum, the lower bound, and the gap to the whole."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from ttr_reward_node.plots.decomposition_error import draw_decomposition_errors
from ttr_reward_node.solvers.decomposition import PLANAR_QUADROTOR_4D, PLANAR_QUADROTOR_FIVE, split
from ttr_reward_node.solvers.steps import crossing_time
from ttr_reward_node.verification import dubins
from ttr_reward_node.verification.cost import make_problem
from ttr_reward_node.verification.decomposition_error import as_table, measure_decomposition_errors

from ctrl_rl_core import GridError, load_navigation_task
from ttr_reward_node import (
    DECOMPOSITIONS,
    DecomposedValue,
    Decomposition,
    TimeToReachError,
    problem_from_task,
    solve,
    solve_decomposed,
)

COARSE = {"x": 9, "v_x": 5, "z": 9, "v_z": 5, "psi": 9, "omega": 5}
CAR = Decomposition("car", (("x", "theta"), ("y", "theta")))
BOX = np.array([[3.7, 4.3], [3.7, 4.3], [0.45, 1.05]])


@pytest.fixture(scope="module")
def quadrotor():
    return problem_from_task("quad_ttr", counts=COARSE)


@cache
def car_bound():
    return solve_decomposed(replace(problem_from_task("car_ttr", counts=(51, 51, 36)), clearance=None), CAR)


def test_who_may_do_what_he_likes(quadrotor):
    assert [part.free for part in split(quadrotor, PLANAR_QUADROTOR_4D)] == [("T_1", "T_2")] * 2
    free = [set(part.free) for part in split(quadrotor, PLANAR_QUADROTOR_FIVE)]
    assert free == [{"v_x"}, {"v_z"}, {"T_1", "T_2"}, {"omega", "T_1", "T_2"}, {"omega", "T_1", "T_2"}]


def test_shadows_of_target_and_obstacles(quadrotor):
    half = split(quadrotor, PLANAR_QUADROTOR_4D)[0].problem
    assert set(half.target.intervals) == {"x", "psi"}
    assert half.clearance is not None
    np.testing.assert_array_equal(half.clearance.values, quadrotor.clearance.values.max(axis=1))


def test_joined_by_the_maximum(quadrotor):
    value = solve_decomposed(quadrotor, PLANAR_QUADROTOR_4D)
    states = np.random.default_rng(0).uniform([-4, -2, 1, -2, -3, -1.5], [4, 2, 9, 2, 3, 1.5], (500, 6))
    parts = np.stack(
        [grid.value(states[:, [0, 1, 4, 5] if grid.axes[0].name == "x" else [2, 3, 4, 5]]) for grid in value.grids]
    )
    np.testing.assert_array_equal(value.value(states), parts.max(axis=0))
    assert value.free == (("T_1", "T_2"), ("T_1", "T_2"))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(x=st.floats(-4.5, 4.5), y=st.floats(-4.5, 4.5), theta=st.floats(-3.1, 3.1))
def test_lower_bound_of_the_exact_time(x, y, theta):
    state = np.array([[x, y, theta]])
    exact, path = dubins.to_box(state, BOX)
    assume(dubins.stays_in(state, path, -5.0, 5.0)[0])
    # The grid blurs jumps of the time by a cell.
    cells = np.stack(np.meshgrid(*([-step, 0.0, step] for step in (0.2, 0.2, 2.0 * np.pi / 36.0))), axis=-1)
    assert car_bound().value(state + cells.reshape(-1, 3)).min() <= exact[0] + 0.05


def test_independent_parts_lose_nothing():
    """Each axis of the point mass has its own control, so the maximum is the solution."""
    whole = make_problem("3D point mass", 2e4)
    parts = Decomposition("axes", (("x",), ("y",), ("z",)))
    (gap,) = measure_decomposition_errors(whole, [parts])
    assert np.median(np.abs(gap.differences)) < 0.01
    assert np.abs(gap.differences).max() < 1.1 * crossing_time(whole)


@pytest.mark.slow
def test_gap_of_the_quadrotor(tmp_path):
    """Axes of five nodes are too coarse to distinguish the whole from its bound."""
    quadrotor = problem_from_task("quad_ttr", counts={"x": 13, "v_x": 9, "z": 13, "v_z": 9, "psi": 13, "omega": 7})
    told = []
    gaps = measure_decomposition_errors(
        quadrotor, DECOMPOSITIONS["planar_quadrotor"].values(), progress=lambda *args: told.append(args)
    )
    four, five = (gap.summary() for gap in gaps)
    assert four["converged"]
    assert four["reachable_bound"] >= four["reachable_whole"] > 0.02
    assert four["lower_bound"] > 0.9
    assert five["lower_bound"] > 0.9
    assert 0.0 < four["mean_s"] < five["mean_s"]
    assert {name for name, _, _ in told} == {"whole", "4d+4d", "five"}
    assert "4d+4d" in as_table(gaps)
    draw_decomposition_errors(gaps, load_navigation_task("quad_ttr"), tmp_path / "gap.png")
    assert (tmp_path / "gap.png").read_bytes().startswith(b"\x89PNG")


def test_refusals(quadrotor):
    with pytest.raises(TimeToReachError, match="height"):
        split(quadrotor, Decomposition("wrong", (("x", "v_x", "z", "v_z", "psi", "omega"), ("height",))))
    with pytest.raises(TimeToReachError, match="omega"):
        split(quadrotor, Decomposition("lacking", (("x", "v_x", "z", "v_z", "psi"),)))
    windy = problem_from_task("quad_ttr", counts=COARSE, disturbances={"d_v_x": (-0.1, 0.1)})
    with pytest.raises(TimeToReachError, match="disturbance"):
        split(windy, PLANAR_QUADROTOR_4D)


def test_pieces_are_solved_like_any_problem(quadrotor):
    for part in split(quadrotor, PLANAR_QUADROTOR_FIVE):
        solution = solve(part.problem)
        assert solution.converged
        assert solution.grid.state_names == part.problem.system.state_names


def test_a_file_with_a_changed_number_is_refused(quadrotor, tmp_path):
    value, file = solve_decomposed(quadrotor, PLANAR_QUADROTOR_4D), tmp_path / "quad.safetensors"
    value.save(file)
    assert DecomposedValue.load(file).digest == value.digest
    content = bytearray(file.read_bytes())
    content[-1000] ^= 1
    file.write_bytes(content)
    with pytest.raises(GridError, match="does not match its digest"):
        DecomposedValue.load(file)
