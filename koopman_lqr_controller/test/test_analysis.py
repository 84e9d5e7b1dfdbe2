"""Control theory of linear models against closed forms and definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.control.linear_analysis import (
    components_for,
    controllability_values,
    costs_of,
    distances_to_nearest,
    jacobian,
    linearise,
    observation_cost,
    participation_ratio,
    patch_costs,
    pbh_distances,
    poles,
    ranks,
    variances,
)
from koopman_lqr_controller.training.analysis.true_system import StraightCorridor

from koopman_lqr_controller import LinearModel, solve_lqr

SEEDS = st.integers(0, 2**31)


def some_model(n: int, m: int, seed: int, radius: float = 0.9) -> LinearModel:
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n))
    return LinearModel(radius * A / np.abs(np.linalg.eigvals(A)).max(), random.normal(size=(n, m)))


def test_poles_come_farthest_first() -> None:
    A = np.array([[0.0, -0.25, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -2.0]])
    assert poles(A) == pytest.approx(np.array([-2.0, 0.5j, -0.5j]))
    assert distances_to_nearest(poles(A), np.array([0.5j, -1.0])) == pytest.approx([1.0, 0.0, 1.0])


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 6), st.integers(1, 3), SEEDS)
def test_a_linear_system_is_its_own_linearisation(n: int, m: int, seed: int) -> None:
    model, random = some_model(n, m, seed), np.random.default_rng(seed)
    found = linearise(model.predict, random.normal(size=n), random.normal(size=m))
    assert pytest.approx(model.A, abs=1e-8) == found.A
    assert pytest.approx(model.B, abs=1e-8) == found.B


def test_a_pendulum_upright_has_the_poles_of_its_matrix_exponential() -> None:
    """theta'' = theta near the upright position: exp(+-dt)."""

    def step(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        for _ in range(400):
            x = x + 0.0005 * np.array([x[1], np.sin(x[0]) + u[0]])
        return x

    found = linearise(step, np.zeros(2), np.zeros(1))
    assert poles(found.A).real == pytest.approx([np.exp(0.2), np.exp(-0.2)], abs=3e-4)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 6), SEEDS)
def test_a_chain_is_controllable_and_a_mode_apart_is_not(n: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    chain = LinearModel(np.diag(random.uniform(0.5, 1.5, n - 1), -1), np.eye(n)[:, :1])
    assert ranks(controllability_values(chain), [1e-10]) == [n]
    assert (pbh_distances(chain) > 1e-6).all()
    A = np.zeros((n + 1, n + 1))
    A[:n, :n], A[n, n] = chain.A, 0.7
    apart = LinearModel(A, np.vstack((chain.B, [[0.0]])))
    assert ranks(controllability_values(apart), [1e-10]) == [n]
    distance = pbh_distances(apart)
    assert distance[np.abs(poles(A) - 0.7).argmin()] == pytest.approx(0.0, abs=1e-12)
    T = np.linalg.qr(random.normal(size=(n + 1, n + 1)))[0]
    turned = LinearModel(T @ A @ T.T, T @ apart.B)
    assert ranks(controllability_values(turned), [1e-8]) == [n], "whatever the coordinates"


def test_the_rank_of_a_growing_system_is_that_of_its_columns() -> None:
    grows = LinearModel(np.diag([20.0, 0.1, 0.2]), np.ones((3, 1)))
    assert ranks(controllability_values(grows), [0.5, 1e-9]) == [1, 3]


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 9), st.floats(0.01, 100.0))
def test_participation_counts_directions_that_share_evenly(n: int, size: float) -> None:
    even = np.full(n, size)
    assert participation_ratio(even) == pytest.approx(n)
    assert participation_ratio(np.append(even, np.zeros(3))) == pytest.approx(n)
    assert components_for(np.append(even, 0.0), 1.0) == n
    assert components_for(np.array([90.0, 9.0, 1.0]), 0.99) == 2


def test_variances_are_those_of_the_principal_axes() -> None:
    random = np.random.default_rng(0)
    z = random.normal(size=(20_000, 3)) * (3.0, 1.0, 0.1) @ np.linalg.qr(random.normal(size=(3, 3)))[0] + 5.0
    assert variances(z) == pytest.approx([9.0, 1.0, 0.01], rel=0.05)


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 6), st.integers(1, 2), SEEDS)
def test_costs_are_read_back_from_gain_and_cost_to_go(n: int, m: int, seed: int) -> None:
    random, m = np.random.default_rng(seed), min(n, m)
    model = some_model(n, m, seed)
    Q, R = np.diag(random.uniform(0.1, 3.0, n)), np.diag(random.uniform(0.1, 3.0, m))
    regulator = solve_lqr(model, Q, R)
    found = costs_of(model, regulator.K, regulator.P)
    assert found[0] == pytest.approx(Q, abs=1e-6)
    if np.linalg.cond(regulator.K) < 1e3:
        assert found[1] == pytest.approx(R, rel=1e-5, abs=1e-5)


@settings(deadline=None, max_examples=20)
@given(SEEDS)
def test_the_cost_of_a_linear_encoder_is_exact(seed: int) -> None:
    random = np.random.default_rng(seed)
    W, Q = random.normal(size=(4, 3)), random.uniform(size=4)
    J = jacobian(lambda x: x @ W.T, random.normal(size=3))
    assert pytest.approx(W, abs=1e-8) == J
    assert observation_cost(np.array([J, J]), Q) == pytest.approx(W.T @ np.diag(Q) @ W, abs=1e-7)


def test_hiding_a_patch_costs_what_it_changes() -> None:
    def encode(images: np.ndarray) -> np.ndarray:
        return images.sum(axis=(1, 3))[:, :2]  # of the two upper rows

    image = np.zeros((1, 5, 4))
    image[0, 0, 3] = 2.0
    cost = patch_costs(encode, image, np.array([3.0, 1.0]), 2, 0.0)
    assert np.array_equal(cost, [[0.0, 3.0 * 2.0**2], [0.0, 0.0]])


def test_the_walls_of_a_straight_corridor_are_where_they_are() -> None:
    corridor = StraightCorridor(0.8, 0.2)
    scan = corridor.scan(np.array([0.1, np.deg2rad(30.0), 0.0, 0.0]))
    assert scan[60] == pytest.approx(0.3, rel=1e-5), "straight to the left wall"
    assert scan[240] == pytest.approx(0.5, rel=1e-5)
    assert scan[0] == pytest.approx(0.3 / np.sin(np.deg2rad(30.0)), rel=1e-5)
    assert np.isinf(scan[330]), "along the corridor"


@settings(deadline=None, max_examples=20)
@given(st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.floats(-0.3, 0.3))
def test_a_unicycle_goes_along_arcs(heading: float, omega: float, v: float) -> None:
    corridor = StraightCorridor(0.8, 0.2)
    after = corridor.step(np.array([0.05, heading, 9.0, 9.0]), np.array([v, omega]))
    x, small = np.array([0.05, heading]), 0.2 / 200
    for _ in range(200):
        x = x + small * np.array([v * np.sin(x[1] + 0.5 * small * omega), omega])
    assert after == pytest.approx([*x, v, omega], abs=1e-5)


def test_the_true_corridor_has_two_poles_at_one() -> None:
    found = linearise(StraightCorridor(0.8, 0.2).step, np.array([0.0, 0.0, 0.2, 0.0]), np.array([0.2, 0.0]))
    assert poles(found.A) == pytest.approx(np.array([1.0, 1.0, 0.0, 0.0]), abs=1e-4)
