"""Selection of latent dimensions on systems with known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.identification.regulators import observed, principal
from koopman_lqr_controller.models.prediction import horizon_errors

from koopman_lqr_controller import KoopmanError


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 2))
def test_what_a_law_asks_for_is_a_linear_system_in_what_it_observes(seed: int, m: int) -> None:
    """Half of the states do not affect the law: the other half is found and is closed under A."""
    random = np.random.default_rng(seed)
    A = np.zeros((8, 8))
    A[:4, :4], A[4:, :] = random.normal(size=(4, 4)), random.normal(size=(4, 8))
    A /= np.abs(np.linalg.eigvals(A)).max()
    basis = np.linalg.qr(random.normal(size=(8, 8)))[0]
    K = np.hstack((random.normal(size=(m, 4)), np.zeros((m, 4)))) @ basis.T
    A = basis @ A @ basis.T
    C = observed(K, A, 4)
    assert pytest.approx(np.eye(4), abs=1e-9) == C @ C.T
    assert pytest.approx(K, abs=1e-8) == K @ C.T @ C
    assert pytest.approx(C @ A, abs=1e-5) == C @ A @ C.T @ C


def test_fewer_directions_are_returned_where_there_are_no_more() -> None:
    assert observed(np.array([[0.0, 2.0, 0.0]]), np.diag([0.5, 0.6, 0.7]), 3) == pytest.approx(
        np.array([[0.0, 1.0, 0.0]])
    )


def test_principal_directions_are_those_that_vary() -> None:
    random = np.random.default_rng(0)
    z = random.normal(size=(200, 3)) * (1.0, 10.0, 1e-7)
    found = principal(z, 1e-4)
    assert np.abs(found) == pytest.approx(np.array([[0, 1, 0], [1, 0, 0]]), abs=0.05)


def stays(z: np.ndarray, _: np.ndarray) -> np.ndarray:
    return z


def test_the_error_of_a_true_model_is_none_and_that_of_no_change_is_one() -> None:
    random = np.random.default_rng(0)
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [0.5]])
    actions = [random.normal(size=(steps, 1)) for steps in (3, 7)]
    z = []
    for done in actions:
        states = [random.normal(size=2)]
        for action in done:
            states.append(A @ states[-1] + B @ action)
        z.append(np.array(states))
    assert horizon_errors(lambda z, u: z @ A.T + u @ B.T, z, actions, 10) == pytest.approx([0.0] * 7, abs=1e-9)
    assert horizon_errors(stays, z, actions, 3) == pytest.approx([1.0] * 3)
    with pytest.raises(KoopmanError, match="no episode"):
        horizon_errors(stays, [], [], 3)
