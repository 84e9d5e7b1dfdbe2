"""The regulator against SciPy's in any units, and each unsolvable problem, rejected with its cause."""

import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.control.inverse_lqr import LinearLaw, fit_costs
from koopman_lqr_controller.control.riccati import finite_horizon
from koopman_lqr_controller.control.scaling import LqrProblem, Units
from scipy.linalg import solve_discrete_are

from koopman_lqr_controller import KoopmanError, LinearModel, solve_lqr

Array = np.ndarray
SEEDS = st.integers(0, 2**31)


def some_problem(random: np.random.Generator, n: int, m: int, radius: float) -> LqrProblem:
    A, B, C, D = (random.normal(size=size) for size in ((n, n), (n, m), (n, n), (m, m)))
    return LqrProblem(
        radius * A / np.abs(np.linalg.eigvals(A)).max(), B, C @ C.T + 0.1 * np.eye(n), D @ D.T + 0.1 * np.eye(m)
    )


def gain(problem: LqrProblem) -> Array:
    return solve_lqr(LinearModel(problem.A, problem.B), problem.Q, problem.R).K


@settings(deadline=None, max_examples=60)
@given(n=st.integers(1, 6), m=st.integers(1, 3), radius=st.floats(0.3, 1.6), seed=SEEDS)
def test_the_gain_is_that_of_scipy_in_whatever_units(n: int, m: int, radius: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    problem = some_problem(random, n, m, radius)
    P = solve_discrete_are(problem.A, problem.B, problem.Q, problem.R)
    expected = problem.gain(P)
    assert gain(problem) == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())
    d, e = (10.0 ** random.uniform(-9.0, 9.0, size) for size in (n, m))
    there = LqrProblem(
        problem.A * d[:, None] / d,
        problem.B * d[:, None] / e,
        problem.Q / np.outer(d, d),
        problem.R / np.outer(e, e),
    )
    assert gain(there) / e[:, None] * d == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


@settings(deadline=None, max_examples=30)
@given(n=st.integers(1, 6), m=st.integers(1, 3), seed=SEEDS)
def test_balanced_units_go_along_with_any_others(n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    problem = some_problem(random, n, m, 0.9)
    d, e = (np.exp2(random.integers(-30, 30, size)) for size in (n, m))
    there = Units(d, e).of(problem)
    one, other = Units.balancing(problem).of(problem), Units.balancing(there).of(there)
    for name in "AB":
        ratio = getattr(other, name) / getattr(one, name)
        assert (np.abs(np.log2(np.abs(ratio))) < 2.1).all(), "powers are rounded, to either side"


@settings(deadline=None, max_examples=40)
@given(n=st.integers(2, 6), hundredths=st.integers(100, 300), seed=SEEDS)
def test_a_mode_that_no_control_moves_is_named(n: int, hundredths: int, seed: int) -> None:
    """In coordinates where the mode takes part in every state, so that no zero entry reveals it."""
    random = np.random.default_rng(seed)
    T, pole = np.linalg.qr(random.normal(size=(n, n)))[0], hundredths / 100.0
    A = np.diag(np.concatenate(([pole], random.uniform(-0.9, 0.9, n - 1))))
    B = np.vstack((np.zeros((1, 1)), np.ones((n - 1, 1))))
    with pytest.raises(KoopmanError, match=rf"cannot be stabilised: no control moves the mode at the pole {pole:g} "):
        solve_lqr(LinearModel(T @ A @ T.T, T @ B), np.eye(n), np.eye(1))


@settings(deadline=None, max_examples=40)
@given(n=st.integers(2, 6), hundredths=st.integers(100, 300), seed=SEEDS)
def test_a_mode_that_costs_nothing_is_named(n: int, hundredths: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    T, pole = np.linalg.qr(random.normal(size=(n, n)))[0], hundredths / 100.0
    A = np.diag(np.concatenate(([pole], random.uniform(-0.9, 0.9, n - 1))))
    Q = np.diag(np.concatenate(([0.0], np.ones(n - 1))))
    with pytest.raises(KoopmanError, match=rf"Q does not see the mode at the pole {pole:g} "):
        solve_lqr(LinearModel(T @ A @ T.T, random.normal(size=(n, 2))), T @ Q @ T.T, np.eye(2))


A = np.array([[1.1, 0.1], [0.0, 0.9]])
B = np.array([[0.0], [1.0]])
Q, R = np.eye(2), np.eye(1)
SPIN = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 0.5]])


def spoilt(array: Array, value: float) -> Array:
    array = array.copy()
    array[0, 0] = value
    return array


REFUSED = {
    "asymmetric Q": (A, B, np.array([[1.0, 0.5], [0.0, 1.0]]), R, r"Q is not symmetric: give 0.5"),
    "negative Q": (A, B, np.diag([1.0, -1.0]), R, r"Q\[1, 1\] is -1: Q must be positive semi-definite"),
    "indefinite Q": (A, B, np.array([[1.0, 2.0], [2.0, 1.0]]), R, "Q is not positive semi-definite"),
    "indefinite Q beside zeros": (A, B, np.array([[0.0, 1.0], [1.0, 0.0]]), R, "Q is not positive semi-definite"),
    "zero R": (A, B, Q, 0.0 * R, r"R\[0, 0\] is 0: R must be positive definite"),
    "negative R": (A, B, Q, -R, r"R\[0, 0\] is -1"),
    "singular R": (A, np.hstack((B, B)), Q, np.ones((2, 2)), "R is not positive definite"),
    "indefinite R": (A, np.hstack((B, B)), Q, np.array([[1.0, 2.0], [2.0, 1.0]]), "R is not positive definite"),
    "nothing costs": (A, B, 0.0 * Q, R, r"Q does not see the mode at the pole 1.1 \(state 0\)"),
    "unseen, growing": (np.diag([1.1, 0.5]), np.ones((2, 1)), np.diag([0.0, 1.0]), R, "Q does not see the mode"),
    "unseen, lasting": (np.diag([1.0, 0.5]), np.ones((2, 1)), np.diag([0.0, 1.0]), R, "Q does not see the mode"),
    "unreached": (np.diag([1.1, 0.5]), B, Q, R, r"no control moves the mode at the pole 1.1 \(state 0\)"),
    "unreached, lasting": (np.diag([1.0, 0.5]), B, Q, R, "no control moves the mode at the pole 1 "),
    "unreached, spinning": (SPIN, np.eye(3)[:, 2:], np.eye(3), R, r"pole 0.6 \+- 0.8i \(states 0, 1\)"),
    "B is zero": (A, 0.0 * B, Q, R, "no control moves the mode"),
    "no control": (A, np.zeros((2, 0)), Q, np.zeros((0, 0)), r"B has shape \(2, 0\)"),
    "no state": (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((0, 0)), R, r"B has shape \(0, 1\)"),
    "a row of B": (A, np.ones(2), Q, R, r"B has shape \(2,\)"),
    "half of A": (A[:1], B, Q, R, r"A has shape \(1, 2\), must have \(2, 2\)"),
    "diagonal of Q": (A, B, np.ones(2), R, r"give np.diag\(Q\)"),
    "R of another model": (A, B, Q, Q, r"R has shape \(2, 2\), must have \(1, 1\)"),
    "complex": (A + 0j, B, Q, R, "A holds complex128 values"),
    "too large": (1e200 * A, B, Q, R, "A holds values up to 1.1e.200: give it in other units"),
    **{f"NaN in {name}": ("NaN", name) for name in "ABQR"},
    **{f"infinity in {name}": ("inf", name) for name in "ABQR"},
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("what", REFUSED)
def test_a_problem_without_a_regulator_is_refused_in_a_line(what: str) -> None:
    found = REFUSED[what]
    if len(found) == 2:
        given = {"A": A, "B": B, "Q": Q, "R": R}
        value, name = found
        given[name] = spoilt(given[name], float(value))
        found = (*given.values(), f"{name} holds values that are not finite")
    *problem, words = found
    with pytest.raises(KoopmanError) as refused:
        solve_lqr(LinearModel(problem[0], problem[1]), problem[2], problem[3])
    assert re.search(words, str(refused.value))
    assert "\n" not in str(refused.value)


def test_what_has_a_regulator_is_no_special_case() -> None:
    assert pytest.approx(0.0) == solve_lqr(LinearModel(0.5 * A, B), 0.0 * Q, R).K, "a stable system for free"
    unseen = solve_lqr(LinearModel(np.diag([0.9, 0.5]), np.ones((2, 1))), np.diag([0.0, 1.0]), R)
    assert unseen.K[0, 0] == pytest.approx(0.0), "what fades by itself need not be seen"
    assert solve_lqr(LinearModel(0.0 * A, B), Q, R).spectral_radius == 0.0
    rounded = np.array([[1.0, 0.5], [0.5 + 1e-15, 1.0]])
    assert pytest.approx(solve_lqr(LinearModel(A, B), rounded.T, R).K) == solve_lqr(LinearModel(A, B), rounded, R).K
    lists = solve_lqr(LinearModel([[1, 1], [0, 1]], [[0], [1]]), [[1, 0], [0, 1]], [[1]])  # type: ignore[arg-type]
    assert pytest.approx(np.array([[0.4221, 1.2439]]), abs=1e-4) == lists.K, "textbook's double integrator"


@settings(deadline=None, max_examples=30)
@given(seed=SEEDS)
def test_a_weak_control_of_a_growing_mode_is_a_matter_of_units(seed: int) -> None:
    """A mode with a control gain of 1e-9 is not rejected by an absolute tolerance, and its closed loop is stable."""
    random = np.random.default_rng(seed)
    reach = 10.0 ** random.uniform(-9.0, 0.0)
    found = solve_lqr(LinearModel(np.diag([1.1, 0.5]), np.array([[reach], [1.0]])), np.diag([reach**-2, 1.0]), R)
    assume(reach < 0.5)
    expected = solve_lqr(LinearModel(np.diag([1.1, 0.5]), np.ones((2, 1))), Q, R).K
    assert found.K * [[reach, 1.0]] == pytest.approx(expected, rel=1e-6)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_finite_horizon_that_leaves_the_numbers_is_refused() -> None:
    with pytest.raises(KoopmanError, match="gain of this model is not finite"):
        finite_horizon(LinearModel(np.diag([1e9, 0.5]), B), np.ones(2), np.ones(1), np.zeros(2), 60)


def test_a_law_and_costs_that_are_none_are_refused() -> None:
    random = np.random.default_rng(0)
    z, weight = random.normal(size=(50, 2)), np.ones(50)
    law = LinearLaw.from_samples(z, -z[:, :1], weight)
    model = LinearModel(A, np.ones((2, 1)))
    for changed, words in (
        ((z, -z[:, :1], 0.0 * weight), "one that is positive"),
        ((z, -z[:, :1], -weight), "not negative"),
        ((spoilt(z, np.nan), -z[:, :1], weight), "z holds values that are not finite"),
        ((z, -z[1:, :1], weight), "u has shape"),
    ):
        with pytest.raises(KoopmanError, match=words):
            LinearLaw.from_samples(*changed)
    for costs, words in (
        ((np.zeros(2), np.ones(1)), "must be positive"),
        ((np.ones(2), -np.ones(1)), "must be positive"),
        ((np.ones(3), np.ones(1)), "Q has shape"),
        ((np.array([np.nan, 1.0]), np.ones(1)), "Q holds values"),
    ):
        with pytest.raises(KoopmanError, match=words):
            fit_costs(model, law, *costs)
