"""GPU kernels against the Numba solver: on the CPU, or on a GPU with CTRL_RL_TEST_DEVICE=cuda."""

import importlib.util
import os
import sys

import numpy as np
import pytest
from ttr_reward_node.kernels.stencil import StepTable, make_grid
from ttr_reward_node.solvers.decomposition import find_decomposition, solve_decomposed, split
from ttr_reward_node.solvers.near_nodes import find_near_nodes
from ttr_reward_node.solvers.node_flags import flag_nodes
from ttr_reward_node.solvers.solver import solve_task
from ttr_reward_node.solvers.steps import crossing_time, make_layout
from ttr_reward_node.solvers.tabulation import make_steps

from ctrl_rl_core import Axis, Interval, Quantity, Region, System
from ttr_reward_node import TimeToReachError, TimeToReachProblem, problem_from_task, solve

DEVICE = os.environ.get("CTRL_RL_TEST_DEVICE", "warp:cpu")
needs_warp = pytest.mark.skipif(
    importlib.util.find_spec("warp") is None, reason="NVIDIA Warp is not installed: requirements/gpu.txt"
)
pytestmark = pytest.mark.filterwarnings("ignore::ttr_reward_node.errors.DoubtfulValueWarning")


def _pendulums(counts):
    """Return as many coupled pendulums as there are (angle, speed) pairs in the grid."""

    def equations(math, _p):
        def rates(x, u, _d):
            pull = math.sin(x[2] - x[0]) if len(x) > 2 else 0.0
            out = x[1], math.sin(x[0]) + 0.5 * pull + u[0]
            return out if len(x) == 2 else (*out, x[3], math.sin(x[2]) - 0.5 * pull + u[1])

        return rates

    names = ("a", "v", "b", "w")[: len(counts)]
    units = ("rad", "rad/s") * 2
    system = System(
        name="pendulums",
        states=tuple(Quantity(name, unit) for name, unit in zip(names, units, strict=False)),
        controls=tuple(Quantity(f"u_{i}", "1", -1.0, 1.0) for i in range(len(counts) // 2)),
        disturbances=tuple(Quantity(f"d_{n}", f"{unit}/s", 0.0, 0.0) for n, unit in zip(names, units, strict=False)),
        parameters={},
        equations=equations,
    )
    axes = tuple(Axis(q.name, q.unit, -1.6, 1.6, count) for q, count in zip(system.states, counts, strict=True))
    return TimeToReachProblem(system, axes, Region({name: Interval(-0.4, 0.4) for name in names}))


def _integrators(axes):
    """Return x' = u on the given axes (name, lower, upper, count, periodic): f depends on no state."""
    states = tuple(Quantity(name, "1", low, high, periodic=turns) for name, low, high, _, turns in axes)
    system = System(
        name="integrators",
        states=states,
        controls=tuple(Quantity(f"u_{i}", "1", -1.0, 1.0) for i in range(len(axes))),
        disturbances=tuple(Quantity(f"d_{s.name}", "1", 0.0, 0.0) for s in states),
        parameters={},
        equations=lambda _math, _p: lambda _x, u, _d: tuple(u),
    )
    grid = tuple(Axis(name, "1", *rest) for name, *rest in axes)
    return TimeToReachProblem(system, grid, Region({axes[0][0]: Interval(-0.3, 0.3), axes[-1][0]: Interval(-0.3, 0.3)}))


PROBLEMS = {
    "no outer axis": lambda: _integrators((("x", -2.0, 2.0, 21, False), ("y", -2.0, 2.0, 21, False))),
    "a periodic row": lambda: _integrators((("x", -2.0, 2.0, 21, False), ("t", -np.pi, np.pi, 24, True))),
    "one axis": lambda: _integrators((("x", -2.0, 2.0, 41, False),)),
    "rows alike": lambda: problem_from_task("car_ttr", counts=(31, 31, 18)),
    "obstacles": lambda: problem_from_task("car_ttr", counts=(31, 31, 18), inflation=0.2),
    "a game": lambda: problem_from_task("car_ttr", counts=(31, 31, 18), disturbances={"d_x": (-0.3, 0.3)}),
    "own steps, all corners": lambda: _pendulums((41, 41)),
    "own steps, simplices": lambda: _pendulums((9, 9, 9, 9)),
}


@needs_warp
@pytest.mark.parametrize("name", PROBLEMS)
def test_gpu_kernels_agree_with_the_compiled_solver(name):
    problem = PROBLEMS[name]()
    ours, theirs = (solve(problem, certify=False, finer=1, device=device) for device in (DEVICE, "cpu"))
    assert ours.converged
    assert theirs.converged
    ours, theirs = ours.grid.values, theirs.grid.values
    reached = np.isfinite(ours) & np.isfinite(theirs)
    assert np.mean(np.isfinite(ours) != np.isfinite(theirs)) <= 0.002
    off, unit = np.abs(ours[reached] - theirs[reached]), crossing_time(problem)
    assert np.median(off) <= 0.02 * unit
    assert np.quantile(off, 0.99) <= 0.15 * unit  # the tolerance is a tenth of the unit
    assert off.max() <= 0.5 * unit


@needs_warp
def test_every_run_on_a_device_gives_the_same_answer():
    problem = PROBLEMS["rows alike"]()
    first, second = (solve(problem, certify=False, device=DEVICE).grid for _ in range(2))
    np.testing.assert_array_equal(first.values, second.values)
    assert first.notes["device"] == DEVICE


@needs_warp
@pytest.mark.parametrize("name", ["rows alike", "obstacles", "own steps, all corners"])
def test_outcomes_near_target_and_obstacles_are_the_same(name):
    from ttr_reward_node.solvers.warp_near_nodes import OutcomeFinder

    problem = PROBLEMS[name]()
    layout = make_layout(problem)
    steps, reach = make_steps(problem, layout)
    flags = flag_nodes(problem, layout, reach)
    axes = len(layout.order)
    grid = make_grid(layout.counts[:axes], layout.periodic[:axes], len(layout.outer))
    discounts = np.exp(-1e-3 * steps.durations).astype(np.float32)
    table = StepTable(
        steps.codes, steps.ends, steps.ranges, steps.lengths > 3.5, steps.controls, discounts, steps.durations
    )
    theirs = find_near_nodes(problem, layout, steps, flags.copy(), table, grid, 1e-3)
    ours = find_near_nodes(
        problem, layout, steps, flags, table, grid, 1e-3, OutcomeFinder(DEVICE.removeprefix("warp:")), 10_000
    )
    np.testing.assert_array_equal(ours.flags, theirs.flags)
    np.testing.assert_allclose(ours.outcomes, theirs.outcomes, atol=1e-6)


@needs_warp
def test_a_solution_of_the_gpu_kernels_is_certified():
    solution = solve(problem_from_task("car_ttr", counts=(41, 41, 24)), device=DEVICE)
    assert solution.converged
    assert not solution.certificate.doubts


@needs_warp
def test_both_converge_to_one_solution_of_a_part_of_the_quadrotor():
    problem = problem_from_task("quad_ttr", counts=(8,) * 6)
    decomposition = find_decomposition(problem.system, "4d+4d")
    part = split(problem, decomposition)[0].problem
    ours, theirs = (
        solve(part, certify=False, tolerance=1e-3, max_sweeps=2000, device=device).grid.values
        for device in (DEVICE, "cpu")
    )
    np.testing.assert_array_equal(np.isfinite(ours), np.isfinite(theirs))
    reached = np.isfinite(ours)
    assert np.median(np.abs(ours[reached] - theirs[reached])) < 0.01
    assert all(grid.notes["device"] == DEVICE for grid in solve_decomposed(problem, decomposition, device=DEVICE).grids)


@pytest.mark.parametrize("device", ["tpu", "cuda:", "cuda0", ""])
def test_unknown_devices_are_refused(device):
    with pytest.raises(TimeToReachError, match="unknown device"):
        solve(problem_from_task("car_ttr", counts=(31, 31, 18)), device=device)


def test_a_gpu_that_is_not_there_is_refused_in_one_line(capfd, tmp_path, monkeypatch):
    from ttr_reward_node.cli.values import solve_value

    monkeypatch.setattr("ttr_reward_node.solvers.devices._driver_is_there", lambda: False)
    monkeypatch.setattr(sys, "argv", ["solve", "--task", "car_ttr", "--device", "cuda"])
    monkeypatch.chdir(tmp_path)
    assert solve_value() == 1
    assert capfd.readouterr().err == "solve: device 'cuda': 0 NVIDIA GPUs with a driver are here; take --device cpu\n"


def test_without_warp_a_gpu_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(TimeToReachError, match="pip install warp-lang"):
        solve(problem_from_task("car_ttr", counts=(31, 31, 18)), device="warp:cpu")


def test_a_grid_that_does_not_fit_on_the_gpu_is_refused(monkeypatch):
    pytest.importorskip("warp")
    monkeypatch.setattr("ttr_reward_node.solvers.warp_sweeper.free_memory", lambda _device: 1e6)
    with pytest.raises(TimeToReachError, match=r"17,298 grid points need .* of the GPU's memory at most, 0\.00 GB"):
        solve(problem_from_task("car_ttr", counts=(31, 31, 18)), device=DEVICE)


def test_safe_sets_run_on_the_cpu_alone(capfd, tmp_path, monkeypatch):
    from ttr_reward_node.cli.values import solve_value

    monkeypatch.setattr(sys, "argv", ["solve", "--task", "car_ttr", "--kind", "avoid", "--device", "cuda"])
    monkeypatch.chdir(tmp_path)
    assert solve_value() == 1
    assert capfd.readouterr().err == "solve: --kind avoid runs on the CPU alone: leave --device out\n"


def test_other_methods_run_on_the_cpu_alone():
    with pytest.raises(TimeToReachError, match="'lax_friedrichs' runs on the CPU alone"):
        solve(problem_from_task("car_ttr", counts=(31, 31, 18)), "lax_friedrichs", device="cuda")
    assert np.isfinite(solve_task("car_ttr", counts=(31, 31, 18)).values).any()
