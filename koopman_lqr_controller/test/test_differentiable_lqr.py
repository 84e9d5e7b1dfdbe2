"""Algorithm 1: against scipy's Riccati equation, a quadratic program, and finite differences."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.control.riccati import finite_horizon
from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr, doubled_gain, riccati_gain
from scipy.linalg import solve_discrete_are

from koopman_lqr_controller import LinearModel, solve_lqr

SEEDS = st.integers(0, 10_000)


def problem(seed: int, n: int = 5, m: int = 2, radius: float = 1.1) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n))
    return {
        "A": A * radius / np.abs(np.linalg.eigvals(A)).max(),
        "B": random.normal(size=(n, m)),
        "Q": random.uniform(0.2, 2.0, n),
        "R": random.uniform(0.2, 2.0, m),
        "z_ref": random.normal(size=n),
    }


def as_torch(given: dict[str, np.ndarray]) -> tuple[torch.Tensor, ...]:
    return tuple(torch.from_numpy(given[name]).double() for name in ("A", "B", "Q", "R", "z_ref"))


@settings(deadline=None, max_examples=30)
@given(SEEDS)
def test_many_iterations_give_the_solution_of_the_riccati_equation(seed: int) -> None:
    given = problem(seed)
    A, B, Q, R = given["A"], given["B"], np.diag(given["Q"]), np.diag(given["R"])
    P = solve_discrete_are(A, B, Q, R)
    expected = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    K, _ = riccati_gain(*as_torch(given), iterations=300)
    assert K.numpy() == pytest.approx(expected, abs=1e-8)


@settings(deadline=None, max_examples=30)
@given(SEEDS, st.integers(1, 6))
def test_doubling_does_many_iterations_at_once(seed: int, doublings: int) -> None:
    A, B, Q, R, _ = as_torch(problem(seed))
    slowly, _ = riccati_gain(A, B, Q, R, torch.zeros(len(Q)).double(), iterations=2**doublings - 1)
    assert doubled_gain(A, B, Q, R, doublings).numpy() == pytest.approx(slowly.numpy(), abs=1e-8)


@settings(deadline=None, max_examples=10)
@given(SEEDS)
def test_the_doubled_gain_has_the_right_gradients(seed: int) -> None:
    given = [part.requires_grad_() for part in as_torch(problem(seed, n=3))[:4]]
    assert torch.autograd.gradcheck(lambda *parts: doubled_gain(*parts, doublings=4), given)


@settings(deadline=None, max_examples=30)
@given(SEEDS, st.integers(1, 8))
def test_torch_and_numpy_agree(seed: int, iterations: int) -> None:
    given = problem(seed)
    expected_K, expected_k, P = finite_horizon(
        LinearModel(given["A"], given["B"]), given["Q"], given["R"], given["z_ref"], iterations
    )
    K, k = riccati_gain(*as_torch(given), iterations=iterations)
    assert K.numpy() == pytest.approx(expected_K, abs=1e-9)
    assert k.numpy() == pytest.approx(expected_k, abs=1e-9)
    assert (np.linalg.eigvalsh(P) > 0).all()


@settings(deadline=None, max_examples=30)
@given(SEEDS, st.integers(1, 4))
def test_it_is_the_first_control_of_the_finite_horizon_optimum(seed: int, iterations: int) -> None:
    """Minimum over all control sequences by one linear system, independent of any recursion."""
    given = problem(seed, n=4, m=2)
    A, B, Q, R, z_ref = (given[name] for name in ("A", "B", "Q", "R", "z_ref"))
    z0, steps = np.random.default_rng(seed).normal(size=4), iterations + 1
    free = np.vstack([np.linalg.matrix_power(A, k + 1) @ z0 for k in range(steps)]).ravel()
    forced = np.zeros((4 * steps, 2 * steps))
    for k in range(steps):
        for j in range(k + 1):
            forced[4 * k : 4 * k + 4, 2 * j : 2 * j + 2] = np.linalg.matrix_power(A, k - j) @ B
    weight, effort = np.diag(np.tile(Q, steps)), np.diag(np.tile(R, steps))
    best = np.linalg.solve(forced.T @ weight @ forced + effort, forced.T @ weight @ (np.tile(z_ref, steps) - free))
    K, k, _ = finite_horizon(LinearModel(A, B), Q, R, z_ref, iterations)
    assert k - K @ z0 == pytest.approx(best[:2], abs=1e-8)


def test_without_a_goal_there_is_no_offset() -> None:
    A, B, Q, R, z_ref = as_torch(problem(0))
    assert not riccati_gain(A, B, Q, R, torch.zeros_like(z_ref), 5)[1].any()


def test_the_latent_lqr_begins_with_a_stable_model_and_a_stable_loop() -> None:
    torch.manual_seed(0)
    lqr = LatentLqr(50, 6, 5)
    K, _ = lqr.gain(torch.zeros(50))
    assert np.abs(np.linalg.eigvals(lqr.A.detach().numpy())).max() == pytest.approx(0.95)
    assert np.abs(np.linalg.eigvals((lqr.A - lqr.B @ K).detach().numpy())).max() < 1.0


@pytest.mark.parametrize("iterations", [1, 5])
def test_gradients_agree_with_finite_differences(iterations: int) -> None:
    given = as_torch(problem(7, n=4))
    leaves = [part.clone().requires_grad_(True) for part in given]
    assert torch.autograd.gradcheck(lambda *parts: riccati_gain(*parts, iterations), leaves, eps=1e-6, atol=1e-6)


def test_the_model_loss_is_that_of_equation_4_7() -> None:
    lqr = LatentLqr(2, 1, 5)
    with torch.no_grad():
        lqr.A.copy_(torch.tensor([[1.0, 0.5], [0.0, 1.0]]))
        lqr.B.copy_(torch.tensor([[0.0], [2.0]]))
    z, u, z_next = torch.tensor([[1.0, 2.0]]), torch.tensor([[0.5]]), torch.tensor([[2.0, 1.0]])
    assert lqr.model_loss(z, u, z_next).item() == pytest.approx(0.0**2 + 2.0**2)


def test_a_finite_horizon_gain_need_not_stabilise_but_the_infinite_one_does() -> None:
    given = problem(3, n=6, m=1, radius=1.3)
    model = LinearModel(given["A"], given["B"])
    regulator = solve_lqr(model, np.diag(given["Q"]), np.diag(given["R"]))
    K, _, _ = finite_horizon(model, given["Q"], given["R"], np.zeros(6), 1)
    assert regulator.spectral_radius < 1.0
    assert np.abs(np.linalg.eigvals(model.A - model.B @ K)).max() > regulator.spectral_radius
