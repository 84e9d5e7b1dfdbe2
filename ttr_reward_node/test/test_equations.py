"""User-defined systems: each is solved, or rejected with one line that states the remedy."""

import math as python_math
from dataclasses import replace

import numpy as np
import pytest
from games import line, plane
from hypothesis import given, settings
from hypothesis import strategies as st

from ctrl_rl_core import Axis, CtrlRlError, Interval, Quantity, Region, System
from ttr_reward_node import METHODS, SafetyGame, TimeToReachError, TimeToReachProblem, roll_out, solve


def system(f, states="xv", controls="u", disturbances=None, parameters=None):
    """Return a system from f(math, x, u, d)."""
    return System(
        name="own",
        states=tuple(Quantity(name, "m") for name in states),
        controls=tuple(Quantity(name, "m/s", -1.0, 1.0) for name in controls),
        disturbances=tuple(Quantity(f"d_{name}", "m/s", *(disturbances or (0.0, 0.0))) for name in states),
        parameters=parameters or {},
        equations=f if f is None else lambda math, _p: lambda x, u, d: f(math, x, u, d),
    )


def axes(names="xv", count=9):
    return tuple(Axis(name, "m", -2.0, 2.0, count) for name in names)


def problem(own, **changes):
    names = "".join(own.state_names)
    return TimeToReachProblem(own, axes(names, **changes), Region({names[0]: Interval(-0.3, 0.3)}))


HOSTILE = {
    "a branch": (lambda _m, x, u, _d: (u[0] if x[0] > 1 else x[1], u[0]), "a branch is arithmetic"),
    "a branch on the control": (lambda _m, x, u, _d: (x[1] if u[0] > 0 else 0.0, u[0]), "a branch is arithmetic"),
    "Python's max": (lambda _m, x, u, _d: (max(x[1], 0.0), u[0]), "a branch is arithmetic"),
    "Python's math": (lambda _m, x, u, _d: (python_math.sin(x[1]), u[0]), "functions of the `math` that is given"),
    "NumPy's max": (lambda m, x, u, _d: (m.max(x[1], 0), u[0]), "'x' at one state depends on which others"),
    "a sum over states": (
        lambda _m, x, u, _d: (x[1] - np.mean(x[1]), u[0]),
        "'x' at one state depends on which others",
    ),
    "what math lacks": (lambda m, x, u, _d: (m.arcsine(x[1]), u[0]), "no attribute 'arcsine'; use the functions"),
    "one too few": (lambda _m, _x, u, _d: (u[0],), "returns 1 derivatives: return one for each of x, v"),
    "one too many": (lambda _m, x, u, _d: (x[1], u[0], 0.0), "returns 3 derivatives"),
    "a number": (lambda _m, _x, _u, _d: 1.0, "let it return a tuple with a derivative for each of x, v"),
    "nothing": (lambda _m, _x, _u, _d: None, "let it return a tuple"),
    "a word": (lambda _m, x, _u, _d: (x[1], "fast"), "the derivative of 'v' is fast: return a real number"),
    "complex numbers": (lambda _m, x, u, _d: (x[1] * 1j, u[0]), "the derivative of 'x' is complex numbers"),
    "a division by zero": (
        lambda _m, x, u, _d: (x[1], u[0] / x[0]),
        r"the derivative of 'v' is (nan|-?inf) at x 0 m, v ",
    ),
    "a root of what is negative": (lambda m, x, u, _d: (m.sqrt(x[1]), u[0]), "the derivative of 'x' is nan at x "),
    "a state too many": (lambda _m, x, u, _d: (x[2], u[0]), "x and d have one component for each state"),
    "a control too many": (lambda _m, x, u, _d: (x[1], u[1]), "u one for each control"),
    "no function": (None, "equations cannot be made: 'NoneType' object is not callable"),
}


@pytest.mark.fault
@pytest.mark.parametrize("name", HOSTILE)
def test_equations_that_the_solvers_cannot_run_are_refused(name):
    f, words = HOSTILE[name]
    with pytest.raises(TimeToReachError, match=words) as refused:
        problem(system(f))
    assert str(refused.value).startswith("own: ")
    assert "\n" not in str(refused.value)
    with pytest.raises(TimeToReachError, match=words):
        SafetyGame(system(f), axes())


@pytest.mark.fault
def test_equations_that_return_no_function_are_refused():
    with pytest.raises(TimeToReachError, match="let them return a function"):
        problem(replace(system(None), equations=lambda _math, _p: (1.0, 2.0)))
    with pytest.raises(TimeToReachError, match="'mass' is no parameter of the system"):
        problem(replace(system(None), equations=lambda _math, p: lambda x, u, _d: (x[1], u[0] / p["mass"])))


@pytest.mark.fault
def test_names_that_stand_twice_and_disturbances_that_do_nothing_are_refused():
    def f(_math, x, u, d):
        return x[1] + d[0], u[0]

    with pytest.raises(TimeToReachError, match="'u' names two states or controls"):
        problem(system(f, controls="uu"))
    with pytest.raises(TimeToReachError, match="'x' names two"):
        problem(system(f, controls="x"))
    with pytest.raises(TimeToReachError, match=r"'d_v' in \[-0.1, 0.1\] acts on nothing: add d\[1\] to the derivative"):
        problem(system(f, disturbances=(-0.1, 0.1)))
    with pytest.raises(TimeToReachError, match="1 disturbances and 2 states"):
        problem(replace(system(f), disturbances=system(f).disturbances[:1]))


def test_what_hides_between_the_ends_is_found():
    """A singularity at one of many nodes of one axis."""
    own = system(lambda _m, x, u, _d: (x[1] / (x[0] - 1.0), u[0]))
    with pytest.raises(TimeToReachError, match=r"'x' is -?(inf|nan) at x 1 m"):
        problem(own, count=1001)


def test_a_system_without_controls_flows():
    """With x' = -1, the time equals the distance to the target, which is unreachable from the other side."""
    own = system(lambda _m, x, _u, _d: (0.0 * x[0] - 1.0,), states="x", controls="")
    flow = problem(own, count=161)
    assert flow.control_samples.shape == (1, 0)
    for method in METHODS:
        values = solve(flow, method).grid
        np.testing.assert_allclose(values.value([[0.5], [1.0], [1.8]]), [0.2, 0.7, 1.5], atol=0.05)
        assert np.isinf(values.value([[-1.0]])[0])
        outcome = roll_out(values, flow, [[1.0]])
        np.testing.assert_allclose(outcome.executed, 0.7, atol=0.02)
    assert SafetyGame(own, axes("x")).pairs()[0].shape == (1, 0)


def test_a_start_in_the_target_is_there():
    solved = line()
    outcome = roll_out(solve(solved).grid, solved, [[0.0], [2.0]])
    np.testing.assert_allclose(outcome.ratio, [1.0, 1.0], atol=0.01)
    assert outcome.executed[0] == 0.0


def test_a_steady_current_is_solved_for_and_driven_in():
    still = plane()
    current, none = still.system.disturbances
    held = replace(current, lower=0.5, upper=0.5), replace(none, lower=0.0, upper=0.0)
    boat = replace(still, system=replace(still.system, disturbances=held))
    assert boat.disturbances == {"d_x": (0.5, 0.5)}
    values = solve(boat).grid
    assert values.notes["disturbances"] == "{'d_x': (0.5, 0.5)}"
    assert values.value([[1.0, 0.0]])[0] == pytest.approx(2.2 / 0.5, abs=0.05)
    outcome = roll_out(values, boat, [[1.0, 0.0], [-1.8, 0.0]])
    assert outcome.reached.all()
    np.testing.assert_allclose(outcome.executed, outcome.predicted, atol=0.15)


PIECES = st.sampled_from(
    [
        lambda _m, x, _u, _d: x[0],
        lambda _m, x, _u, _d: x[-1],
        lambda _m, _x, u, _d: u[0],
        lambda _m, _x, u, _d: u[-1] ** 3 - u[-1],
        lambda _m, _x, _u, d: d[0],
        lambda m, x, _u, _d: m.sin(x[0]),
        lambda m, x, _u, _d: m.sqrt(x[0]),
        lambda m, x, _u, _d: m.log(x[-1] * x[-1]),
        lambda _m, x, _u, _d: 1.0 / x[0],
        lambda _m, x, _u, _d: abs(x[0]),
        lambda _m, x, u, _d: (x[0] > 0.5) * u[0],
        lambda _m, x, u, _d: u[0] if x[0] > 0.5 else 0.0,
        lambda m, x, _u, _d: m.maximum(x[0], 0.0),
        lambda m, x, _u, _d: m.sum(x[0]),
        lambda _m, x, _u, _d: x[0].tolist(),
        lambda _m, x, _u, _d: [x[0], x[0]],
        lambda _m, x, _u, _d: int(x[0]),
        lambda m, x, _u, _d: m.exp(9e9 * x[0]),
        lambda _m, _x, _u, _d: None,
        lambda _m, _x, _u, _d: float("nan"),
        lambda _m, x, _u, _d: 1e-300 * x[0],
        lambda _m, x, _u, _d: x["x"],
        lambda _m, _x, _u, _d: 1 // 0,
    ]
)


@settings(max_examples=150, deadline=None)
@given(
    pieces=st.lists(st.tuples(PIECES, PIECES), min_size=0, max_size=3),
    states=st.integers(1, 2),
    controls=st.integers(0, 2),
    bound=st.sampled_from([0.0, 0.0, 0.3]),
    counts=st.sampled_from([None, None, 2, 0, (3,), "many"]),
)
def test_whatever_somebody_writes_is_solved_or_refused_in_one_line(pieces, states, controls, bound, counts):
    own = system(
        lambda m, x, u, d: tuple(one(m, x, u, d) + two(m, x, u, d) for one, two in pieces),
        states="xv"[:states],
        controls="uw"[:controls],
        disturbances=(-bound, bound),
    )
    refused, values = "", np.zeros(1)
    try:
        values = solve(replace(problem(own), control_counts=counts), max_sweeps=60).grid.values
    except CtrlRlError as error:
        refused = str(error)
    assert (values >= 0.0).all()
    assert "\n" not in refused
