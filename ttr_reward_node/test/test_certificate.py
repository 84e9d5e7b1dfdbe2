"""Certificates: no doubt about correct times to reach from any solver, and a one-line warning for wrong ones."""

import json
from dataclasses import replace

import numpy as np
import pytest
from games import double_integrator, line, plane
from ttr_reward_node.certificates.certificate import Certificate
from ttr_reward_node.cli.values import check, solve_value

from ctrl_rl_core import Axis, Interval, Quantity, Region, System, ValueGrid
from ttr_reward_node import (
    DoubtfulValueWarning,
    TimeToReachError,
    TimeToReachProblem,
    certify,
    problem_from_task,
    solve,
)


def on_grid(problem, values):
    """Return a value grid of the problem with given values, which are broadcast."""
    shaped = np.broadcast_to(np.asarray(values, dtype=np.float32), problem.counts)
    return ValueGrid(shaped, problem.axes, "time_to_reach", "custom", problem.content_digest, "semi_lagrangian", 0.0)


def line_times(problem):
    """Return the time to the target's edge for x' = u + d, against the disturbance."""
    low, high = problem.target.intervals["x"]
    nodes = problem.axes[0].nodes
    disturbance = problem.system.disturbance_bounds[1, 0]
    return np.maximum(np.maximum(low - nodes, nodes - high), 0.0) / (1.0 - disturbance)


def wall(x, y):
    """Return the distance to a wall that blocks most of the path to the target."""
    return np.maximum(np.abs(x) - 0.15, np.abs(y) - 1.0)


def car(**options):
    """Return the car's problem on a grid with about half the task's nodes along each axis."""
    return problem_from_task("car_ttr", counts=(51, 51, 36), **options)


RIGHT = {
    "line": line(),
    "line against a disturbance": line(0.3),
    "cart": double_integrator(),
    "cart against a disturbance": double_integrator(0.3),
    "plane": plane(),
    "plane with a wall": plane(wall),
    "car": replace(car(), clearance=None),
    "car among obstacles": car(inflation=0.354),
    "car in the wind": problem_from_task(
        "car_ttr", counts=(51, 51, 36), inflation=0.354, disturbances={"d_x": (-0.2, 0.2)}
    ),
    "car in a current": problem_from_task(
        "car_ttr", counts=(51, 51, 36), inflation=0.354, disturbances={"d_x": (0.2, 0.2)}
    ),
}


@pytest.mark.parametrize("name", RIGHT)
def test_right_solutions_are_not_doubted(name):
    solution = solve(RIGHT[name])
    found = solution.certificate
    assert found is not None
    assert found.doubts == ()
    assert found.arrived > 0.85
    assert found.ratio_median == pytest.approx(1.0, abs=0.03)
    for seed in (1, 2):
        assert certify(solution, RIGHT[name], seed=seed).doubts == ()


@pytest.mark.parametrize("disturbance", [0.0, 0.4])
def test_times_that_are_wrong_by_a_factor_are_doubted(disturbance):
    problem = line(disturbance, count=121)
    times = line_times(problem)
    assert certify(on_grid(problem, times), problem).doubts == ()
    (small,) = certify(on_grid(problem, 0.6 * times), problem).doubts
    assert "% longer than the solution predicts" in small or "drives arrive" in small
    large = certify(on_grid(problem, 1.8 * times), problem)
    assert "the target is" in large.doubts[0]
    assert "but the solution says" in large.doubts[0]
    assert large.contradictions > 0


@pytest.mark.parametrize("disturbance", [0.0, 0.4, 0.75])
def test_states_that_are_wrongly_called_unreachable_are_found(disturbance):
    problem = line(disturbance, count=121)
    half = np.where(problem.axes[0].nodes > 1.0, np.inf, line_times(problem))
    found = certify(on_grid(problem, half), problem)
    assert "m the target is" in found.doubts[0]
    assert "but the solution calls it unreachable" in found.doubts[0]
    assert "more nodes, first along 'x' (121), or try lax_friedrichs" in found.doubts[0]
    assert "unreachable" in certify(on_grid(problem, np.where(problem.in_target(), 0.0, np.inf)), problem).doubts[0]


def test_what_only_switching_reaches_is_found():
    """Speeds marked unreachable that a cart reaches by switching its control a few times."""
    cart = double_integrator()
    phi = solve(cart).grid.values
    fast = np.abs(cart.axes[1].nodes) > 1.5
    found = certify(on_grid(cart, np.where(fast, np.inf, phi)), cart)
    assert "unreachable" in found.doubts[0]


def test_values_that_lead_nowhere_are_doubted():
    """Values that grow towards the target, and values of a world without its wall."""
    problem = line()
    away = on_grid(problem, 3.1 - np.abs(problem.axes[0].nodes))
    assert "drives arrive; the one from x" in certify(away, problem).doubts[-1]
    walled = plane(lambda x, y: np.maximum(np.abs(x + 0.7) - 0.15, np.abs(y) - 1.9))
    assert any(
        "drives arrive" in doubt for doubt in certify(on_grid(walled, solve(plane()).grid.values), walled).doubts
    )


def test_values_of_another_system_are_doubted():
    """The solution ignores a speed limit, or a disturbance."""
    free = TimeToReachProblem(
        system=double_integrator().system,
        axes=(Axis("x", "m", -6.0, 6.0, 121), Axis("v", "m/s", -2.0, 2.0, 41)),
        target=Region({"x": Interval(-0.2, 0.2), "v": Interval(-0.2, 0.2)}),
    )
    slow = replace(free.system.states[1], lower=-0.5, upper=0.5)
    limited = replace(free, system=replace(free.system, states=(free.system.states[0], slow)))
    solution = solve(free)
    assert solution.certificate.doubts == ()
    assert certify(solution, limited).doubts != ()
    assert certify(solve(line()), line(0.5)).doubts != ()


def test_python_is_warned_of_doubts():
    """Times from Lax-Friedrichs are too long near jumps."""
    with pytest.warns(DoubtfulValueWarning, match="but the solution says"):
        solution = solve(car(inflation=0.354), "lax_friedrichs")
    assert Certificate.from_notes(solution.grid.notes) == solution.certificate


def test_few_samples_of_a_control_are_doubted():
    system = System(
        name="boat",
        states=(Quantity("x", "m"), Quantity("y", "m")),
        controls=(Quantity("heading", "rad", -np.pi, np.pi),),
        disturbances=(Quantity("d_x", "m/s", 0.0, 0.0), Quantity("d_y", "m/s", 0.0, 0.0)),
        parameters={},
        equations=lambda m, _p: lambda _x, u, _d: (m.cos(u[0]) + 0.5, m.sin(u[0])),
    )
    axes = (Axis("x", "m", -3.0, 3.0, 61), Axis("y", "m", -3.0, 3.0, 61))
    target = Region({"x": Interval(-0.3, 0.3), "y": Interval(-0.3, 0.3)})
    assert solve(TimeToReachProblem(system, axes, target)).certificate.doubts == ()
    few = solve(TimeToReachProblem(system, axes, target, control_counts=4)).certificate
    assert "solve with more, such as --controls heading=33" in few.doubts[0]
    assert few.contradictions > 0  # backward paths also use controls between the samples


@pytest.mark.parametrize("ratio", [1.0, 100.0])
def test_systems_with_slow_and_fast_states_are_certified(ratio):
    """Steps are measured in cells, so the slow axis takes as many as the fast one."""
    boat = plane(count=61)
    fast = replace(boat.system, equations=lambda _m, _p: lambda _x, u, d: (u[0] + d[0], ratio * u[1] + d[1]))
    problem = replace(boat, system=fast)
    x, y = (problem.along(k, axis.nodes) for k, axis in enumerate(problem.axes))
    times = np.maximum(np.maximum(np.maximum(-1.6 - x, x + 1.2), 0.0), np.maximum(np.abs(y) - 0.2, 0.0) / ratio)
    right = certify(on_grid(problem, times), problem)
    assert right.doubts == ()
    assert right.arrived > 0.95
    assert certify(on_grid(problem, 2.0 * times), problem).doubts != ()
    assert certify(on_grid(problem, 0.5 * times), problem).doubts != ()


def test_a_certificate_is_kept_in_the_file_and_printed(tmp_path, capsys):
    file = str(tmp_path / "car.safetensors")
    coarse = ["--task", "car_ttr", "--count", "x=31", "y=31", "theta=24", "--robot-size", "--output", file]
    assert solve_value([*coarse, "--strict"]) == 0
    said = capsys.readouterr().out
    assert "certified  " in said
    assert "times the predicted time" in said
    assert "doubt" not in said
    value = ValueGrid.load(file)
    kept = Certificate.from_notes(value.notes)
    assert kept is not None
    assert kept.line in said
    assert f"grid       {kept.grid}" in said
    assert check([file, "--starts", "20"]) == 0
    assert kept.line in capsys.readouterr().out
    assert solve_value([*coarse, "--overwrite", "--strict", "--controls", "omega=2", "--method", "lax_friedrichs"]) == 1
    assert "doubt      " in capsys.readouterr().out
    assert Certificate.from_notes({}) is None
    assert solve(line(), certify=False).certificate is None


def test_a_coarse_grid_is_told_with_what_to_change():
    """With half the nodes, the times change a lot on a coarse grid and hardly on a fine one."""
    counts = (21, 21, 16), (81, 81, 64)
    free = [replace(problem_from_task("car_ttr", counts=each), clearance=None) for each in counts]
    coarse, fine = (solve(problem).certificate.grid for problem in free)
    assert coarse.startswith("on 11 x 11 x 8 nodes in place of 21 x 21 x 16 times differ by ")
    assert ": solve with more nodes, first along '" in coarse
    assert fine.endswith("% (median)")
    assert solve(plane(wall)).certificate.grid.startswith("on 81 x 81 nodes in place of 161 x 161 times differ by 0.")


@pytest.mark.fault
@pytest.mark.parametrize(
    "note",
    [
        "",
        "[]",
        "{}",
        "null",
        "9" * 5000,
        "[" * 100_000,
        json.dumps({"drives": 1, "arrived": float("nan")}),
        '{"drives": "a"}',
    ],
)
def test_notes_that_are_no_certificate_are_refused(note):
    with pytest.raises(TimeToReachError, match="the value's certificate cannot be read"):
        Certificate.from_notes({"certificate": note})


def test_a_value_of_another_problem_is_refused():
    with pytest.raises(TimeToReachError, match="certify the value of this problem"):
        certify(solve(line()), plane())
