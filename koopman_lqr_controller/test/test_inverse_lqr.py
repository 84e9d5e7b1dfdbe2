"""Costs that make a law optimal: gradients, and laws with known costs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.control.inverse_lqr import LinearLaw, fit_costs, mismatch_and_gradient

from koopman_lqr_controller import KoopmanError, LinearModel, solve_lqr


def some_model(random: np.random.Generator, n: int = 4, m: int = 2) -> LinearModel:
    A = random.normal(size=(n, n))
    return LinearModel(A * 1.1 / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(n, m)))


def law_of(K: np.ndarray, random: np.random.Generator) -> LinearLaw:
    z = random.normal(size=(500, K.shape[1]))
    return LinearLaw.from_samples(z, -z @ K.T, random.uniform(0.1, 1.0, 500))


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000))
def test_the_gradient_agrees_with_finite_differences(seed: int) -> None:
    random = np.random.default_rng(seed)
    model, logs = some_model(random), random.normal(size=6)
    law = law_of(random.normal(size=(2, 4)), random)
    gradient = mismatch_and_gradient(logs, model, law)[1]

    def value(x: np.ndarray) -> float:
        return mismatch_and_gradient(x, model, law)[0]

    steps = 1e-5 * np.eye(6)  # on both sides: one side is too far off where the mismatch bends
    slopes = [(value(logs + step) - value(logs - step)) / 2e-5 for step in steps]
    assert np.linalg.norm(slopes - gradient) < 1e-4 * max(1.0, float(np.linalg.norm(gradient)))


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 10_000))
def test_a_law_that_is_optimal_for_some_cost_is_found_again(seed: int) -> None:
    random = np.random.default_rng(seed)
    model = some_model(random)
    Q, R = random.uniform(0.1, 3.0, 4), random.uniform(0.3, 2.0, 2)
    K = solve_lqr(model, np.diag(Q), np.diag(R)).K
    found_Q, found_R, left = fit_costs(model, law_of(K, random), np.ones(4), np.ones(2))
    assert left < 1e-3
    found = solve_lqr(model, np.diag(found_Q), np.diag(found_R))
    assert found.spectral_radius < 1.0
    assert np.linalg.norm(found.K - K) < 0.05 * np.linalg.norm(K)


def test_the_mismatch_is_none_for_the_law_itself_and_one_for_no_law() -> None:
    random = np.random.default_rng(0)
    K = random.normal(size=(2, 4))
    law = law_of(K, random)
    assert law.mismatch(K) == pytest.approx(0.0, abs=1e-12)
    assert law.mismatch(0.0 * K) == pytest.approx(1.0)


def test_a_model_that_cannot_be_stabilised_is_refused() -> None:
    model = LinearModel(np.diag([1.5, 0.5]), np.array([[0.0], [1.0]]))
    law = law_of(np.ones((1, 2)), np.random.default_rng(0))
    with pytest.raises(KoopmanError, match="no LQR for this model"):
        fit_costs(model, law, np.ones(2), np.ones(1))
