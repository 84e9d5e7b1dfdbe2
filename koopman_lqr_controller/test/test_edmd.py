"""EDMD against systems with known Koopman models, and the regulator against independent solutions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.models.edmd import persistence_error

from koopman_lqr_controller import KoopmanError, LinearModel, Snapshots, fit, solve_lqr


def random_stable(n: int, m: int, seed: int) -> LinearModel:
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n))
    return LinearModel(0.9 * A / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(n, m)))


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 8), st.integers(1, 3), st.integers(0, 2**31))
def test_a_linear_system_is_recovered(n: int, m: int, seed: int) -> None:
    true = random_stable(n, m, seed)
    random = np.random.default_rng(seed)
    z, u = random.normal(size=(20 * (n + m), n)), random.normal(size=(20 * (n + m), m))
    model = fit(Snapshots(z, u, true.predict(z, u)), regularisation=0.0)
    assert pytest.approx(true.A, abs=1e-9) == model.A
    assert pytest.approx(true.B, abs=1e-9) == model.B


def test_the_slow_manifold_becomes_linear_in_its_koopman_coordinates() -> None:
    """x1' = a x1, x2' = b x2 + (a^2 - b) x1^2 + u is linear in (x1, x2, x1^2): a standard example of Koopman theory."""
    a, b = 0.9, 0.5
    random = np.random.default_rng(0)
    x, u = random.uniform(-1, 1, (200, 2)), random.uniform(-1, 1, (200, 1))
    after = np.column_stack((a * x[:, 0], b * x[:, 1] + (a**2 - b) * x[:, 0] ** 2 + u[:, 0]))

    def lift(x: np.ndarray) -> np.ndarray:
        return np.column_stack((x, x[:, 0] ** 2))

    model = fit(Snapshots(lift(x), u, lift(after)), regularisation=0.0)
    assert pytest.approx(np.array([[a, 0, 0], [0, b, a**2 - b], [0, 0, a**2]]), abs=1e-9) == model.A
    assert pytest.approx(np.array([[0], [1], [0]]), abs=1e-9) == model.B
    assert np.sort(np.linalg.eigvals(model.A)) == pytest.approx([b, a**2, a])


def test_a_model_beats_persistence_where_something_moves() -> None:
    true = random_stable(4, 2, 3)
    random = np.random.default_rng(3)
    z, u = random.normal(size=(300, 4)), random.normal(size=(300, 2))
    data = Snapshots(z, u, true.predict(z, u) + 0.01 * random.normal(size=(300, 4)))
    assert (fit(data).one_step_error(data) < 0.1 * persistence_error(data)).all()


def test_mirrored_data_give_a_model_that_commutes_with_the_mirror() -> None:
    random = np.random.default_rng(1)
    data = Snapshots(random.normal(size=(100, 3)), random.normal(size=(100, 2)), random.normal(size=(100, 3)))
    z_sign, u_sign = np.array([-1.0, -1.0, 1.0]), np.array([1.0, -1.0])
    model = fit(data + data.mirrored(z_sign, u_sign))
    assert np.diag(z_sign) @ model.A @ np.diag(z_sign) == pytest.approx(model.A)
    assert np.diag(z_sign) @ model.B @ np.diag(u_sign) == pytest.approx(model.B)


def test_too_few_or_broken_snapshots_are_refused() -> None:
    with pytest.raises(KoopmanError, match="too few"):
        fit(Snapshots(np.zeros((3, 4)), np.zeros((3, 2)), np.zeros((3, 4))))
    z = np.full((10, 2), np.nan)
    with pytest.raises(KoopmanError, match="not finite"):
        fit(Snapshots(z, np.zeros((10, 1)), z))


def test_the_scalar_regulator_is_the_closed_form() -> None:
    """p = q + a^2 p - (a b p)^2 / (r + b^2 p), solved analytically for a = 1.2, b = 1, q = r = 1."""
    a, b, q, r = 1.2, 1.0, 1.0, 1.0
    p = (a**2 * r + q * b**2 - r + np.sqrt((a**2 * r + q * b**2 - r) ** 2 + 4 * q * r * b**2)) / (2 * b**2)
    regulator = solve_lqr(LinearModel(np.array([[a]]), np.array([[b]])), np.array([[q]]), np.array([[r]]))
    assert regulator.P[0, 0] == pytest.approx(p)
    assert regulator.K[0, 0] == pytest.approx(a * b * p / (r + b**2 * p))


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 6), st.integers(1, 2), st.integers(0, 2**31))
def test_the_gain_is_the_limit_of_value_iteration(n: int, m: int, seed: int) -> None:
    model = random_stable(n, m, seed)
    A, B, Q, R = model.A, model.B, np.eye(n), np.eye(m)
    regulator = solve_lqr(model, Q, R)
    P = Q
    for _ in range(500):
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A - B @ K)
    assert pytest.approx(K, abs=1e-7) == regulator.K
    assert regulator.spectral_radius < 1.0
    assert regulator.residual < 1e-8


def test_a_model_without_control_over_a_growing_mode_is_refused() -> None:
    model = LinearModel(np.diag([1.1, 0.5]), np.array([[0.0], [1.0]]))
    with pytest.raises(KoopmanError, match=r"stabilis|no LQR"):
        solve_lqr(model, np.eye(2), np.eye(1))
