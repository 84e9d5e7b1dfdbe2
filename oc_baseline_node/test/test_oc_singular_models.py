"""Models without a derivative, or a value, at the start of a trajectory: MPC returns a trajectory or one error line."""

import sys
from pathlib import Path

import casadi
import numpy as np
import pytest
from oc_baseline_node.cli import main
from oc_baseline_node.mpc.limited import LimitedSolver
from oc_baseline_node.mpc.rounded import rounded

sys.path.insert(0, str(Path(__file__).parents[2] / "test" / "attack"))

from _singular_models import TERMS, make_problem, random_problem
from mpc import TIME_LIMIT, solve_one

from ctrl_rl_core import exclusive_lock
from oc_baseline_node import Mpc, OcError, RecedingHorizon


@pytest.mark.parametrize("seed", range(30))
def test_a_random_singular_model_ends(seed: int, tmp_path: Path) -> None:
    solve_one(np.random.default_rng(seed), tmp_path)


@pytest.mark.parametrize("solver", ["fatrop", "ipopt"])
@pytest.mark.parametrize("name", ["quadratic drag by a root", "length", "power 1.5", "hyperbolic arc cosine"])
def test_a_model_without_a_derivative_at_rest_is_solved_from_rest(name: str, solver: str, tmp_path: Path) -> None:
    problem = make_problem([(name, 2, 2, 0.3), (name, 3, 3, 0.3)], tmp_path, goal=2.0, horizon=25)
    trajectory = Mpc(problem, (solver,)).solve(np.zeros(4))
    assert trajectory.solved, trajectory.reason
    steps = problem.system.step(trajectory.states[:-1], trajectory.controls, dt=trajectory.time_step)
    assert np.abs(trajectory.states[1:] - steps).max() <= 1e-4, "the model's own dynamics, not the rounded ones"


def test_a_model_without_a_value_at_the_start_is_named(tmp_path: Path) -> None:
    problem = make_problem([("sine over angle", 3, 2, 0.3)], tmp_path)
    mpc = Mpc(problem)
    reason = mpc.solve(np.zeros(4)).reason
    assert reason.startswith("start: the model's rate of v_y is nan at x = 0, y = 0, v_x = 0, v_y = 0")
    assert mpc.solve((0.0, 0.0, 0.1, 0.0)).reason != reason
    controller = RecedingHorizon(mpc)
    assert controller.control(np.zeros(4)) == pytest.approx([0.0, 0.0])
    assert controller.reason == reason


def test_a_derivative_that_is_no_number_is_named_where_there_is_no_trajectory(tmp_path: Path) -> None:
    problem = make_problem([("length", 2, 2, 0.3)], tmp_path, goal=3.0, horizon=2)
    reason = Mpc(problem).solve(np.zeros(4)).reason
    assert reason.endswith("the derivative of the rate of v_x by v_x is nan at the start"), reason


def test_equations_that_casadi_cannot_take_are_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TERMS, "numpy's own", lambda m, v, c: -c * m.heaviside(v, 0.5))
    problem = make_problem([("numpy's own", 2, 2, 0.3)], tmp_path)
    with pytest.raises(OcError, match=r"model 'random_model': CasADi cannot differentiate it: .*heaviside"):
        Mpc(problem).solve(np.zeros(4))


def endless() -> casadi.Function:
    """Return fatrop on a program with a NaN Jacobian at the initial point, on which it never terminates."""
    x, u, y = (casadi.SX.sym(name) for name in "xuy")
    g = casadi.vertcat(y - x - u + casadi.sqrt(x * x + u * u), x)
    nlp = {"x": casadi.vertcat(x, u, y), "f": x * x + u * u + y * y, "g": g}
    options = {"structure_detection": "auto", "equality": [True, True], "fatrop": {"print_level": 0, "max_iter": 100}}
    return casadi.nlpsol("endless", "fatrop", nlp, {**options, "print_time": False})


def test_a_solver_that_never_ends_is_ended_and_asked_again() -> None:
    solver = LimitedSolver(endless())
    call = {"lbx": np.full(3, -9.0), "ubx": np.full(3, 9.0), "lbg": np.zeros(2), "ubg": np.zeros(2)}
    assert solver({"x0": np.zeros(3), **call}, 0.5) is None
    call["lbg"] = call["ubg"] = np.array([0.0, 1.0])
    answer = solver({"x0": np.ones(3), **call}, 5.0)
    assert answer is not None
    assert answer.iterations > 0
    assert 0.0 < answer.seconds < 5.0


def test_a_solvers_process_holds_no_lock_of_its_parent(tmp_path: Path) -> None:
    solver = LimitedSolver(endless())
    call = {"x0": np.ones(3), "lbx": np.full(3, -9.0), "ubx": np.full(3, 9.0)}
    with exclusive_lock(tmp_path / "lock"):
        assert solver({**call, "lbg": np.zeros(2), "ubg": np.zeros(2)}, 5.0) is not None
    with exclusive_lock(tmp_path / "lock"):
        pass


def test_the_time_of_a_start_is_bounded(tmp_path: Path) -> None:
    problem, start, _ = random_problem(np.random.default_rng(3), tmp_path)
    trajectory = Mpc(problem, time_limit=0.02).solve(start)
    assert not trajectory.solved
    assert "CPU s" in trajectory.reason
    assert trajectory.cpu_seconds <= 0.1
    with pytest.raises(OcError, match="time limit is 0 s"):
        Mpc(problem, time_limit=0.0)
    assert TIME_LIMIT > 0.0


@pytest.mark.parametrize("name", sorted(TERMS))
def test_rounded_operations_are_finite_everywhere_and_the_same_elsewhere(name: str) -> None:
    v = casadi.SX.sym("v")
    own = casadi.Function("own", [v], [TERMS[name](casadi, v, 0.7)])
    function, _ = rounded(own)
    both = casadi.Function("both", [v], [function(v), casadi.jacobian(function(v), v)])
    numbers = name not in ("not a number", "not a number times", "infinite", "zero over zero")
    for value in (-2.0, -1.0, -1e-12, 0.0, 1e-12, 0.3, 1.0, 2.0):
        expected, *beside = (float(own(value + apart)) for apart in (0.0, -1e-3, 1e-3))
        out, slope = (float(each) for each in both(value))
        assert np.isfinite([out, slope]).all() or not numbers, f"{name} at {value}: {out}, {slope}"
        if np.isfinite([expected, *beside]).all() and abs(value) >= 0.3 and abs(expected) < 1e3:
            assert out == pytest.approx(expected, abs=2e-5)


def test_a_smooth_model_is_left_as_it_is() -> None:
    x = casadi.SX.sym("x", 2)
    own = casadi.Function("own", [x], [casadi.sin(x[0]) * x[1] ** 3 / 2.0 - casadi.tanh(x[0])])
    assert rounded(own) == (own, ())


def test_oc_says_what_was_rounded_off_and_whose_bounds_it_took(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_problem([("length", 2, 2, 0.3)], tmp_path, controls={"a_x": "-1 .. 1 m/s^2"})
    file = str(tmp_path / "random_model.yaml")
    assert main(["solve", file, "--start=0,0,0,0"]) == 0
    said = capsys.readouterr().out
    assert "rounded off   hypot: no derivative somewhere" in said
    assert "control       a_y -1 .. 1 m/s^2: the model's own bounds, as the task names none" in said
    assert "a_x -1" not in said
    assert main(["extract", file]) == 0
    assert "a_y -1 .. 1 (the model's own bounds, as the task names none)" in capsys.readouterr().out
