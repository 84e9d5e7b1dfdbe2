"""Prediction errors and their lower bounds, on systems where both are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from koopman_lqr_controller.models.prediction import horizon_errors, law_error, linear_floor, noise_floor
from koopman_lqr_controller.training.analysis.disturbance_ablation import ablate_disturbances
from koopman_lqr_controller.training.analysis.policy_world import make_world
from koopman_lqr_controller.training.environments.corridor import Conditions

from koopman_lqr_controller import find_policy, load_policy

A = np.array([[0.9, 0.2], [-0.2, 0.9]])
B = np.array([[0.0], [1.0]])


def episodes(seed: int, noise: float = 0.0, bend: float = 0.0) -> tuple[list[np.ndarray], ...]:
    """Return states, two noisy observations of each, and actions, of z_{k+1} = A z_k + B u_k + bend sin(3 z_k)."""
    random = np.random.default_rng(seed)
    true, u = [], []
    for _ in range(4):
        z, done = [random.normal(size=2)], random.normal(size=(300, 1))
        for each in done:
            z.append(A @ z[-1] + B @ each + bend * np.sin(3.0 * z[-1]))
        true.append(np.array(z))
        u.append(done)
    looks = [[z + noise * random.normal(size=z.shape) for z in true] for _ in range(2)]
    return true, *looks, u


def predict(z: np.ndarray, u: np.ndarray) -> np.ndarray:
    return z @ A.T + u @ B.T


def test_who_knows_the_next_state_misses_the_noise_and_nothing_else() -> None:
    true, look, again, u = episodes(0, noise=0.3)
    missed = sum(np.sum((seen[1:] - known[1:]) ** 2) for seen, known in zip(look, true, strict=True))
    moved = sum(np.sum(np.diff(seen, axis=0) ** 2) for seen in look)
    assert noise_floor(look, again) == pytest.approx(np.sqrt(missed / moved), rel=0.05)
    assert noise_floor(look, again) < horizon_errors(predict, look, u, 1)[0]
    assert noise_floor(true, true) == 0.0


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), bend=st.floats(0.0, 1.0), wrong=st.floats(-0.3, 0.3))
def test_no_linear_model_is_better_than_the_best_one(seed: int, bend: float, wrong: float) -> None:
    _, look, _, u = episodes(seed, 0.1, bend)
    floor = linear_floor(look, u)
    assert floor <= horizon_errors(lambda z, v: predict(z, v) + wrong * z, look, u, 1)[0] + 1e-9


def test_what_is_not_linear_is_in_one_floor_and_not_in_the_other() -> None:
    true, _, _, u = episodes(1)
    assert linear_floor(true, u) < 1e-6
    bent, _, _, v = episodes(1, bend=0.5)
    assert linear_floor(bent, v) > 0.05
    assert noise_floor(bent, bent) == 0.0


def test_the_error_of_the_law_does_not_depend_on_coordinates() -> None:
    _, look, _, u = episodes(2, noise=0.3)
    K, T = np.array([[0.3, -1.0]]), np.diag((100.0, 0.1))

    def other(z: np.ndarray, v: np.ndarray) -> np.ndarray:
        return predict(z @ np.linalg.inv(T).T, v) @ T.T

    there = [z @ T.T for z in look]
    assert law_error(other, K @ np.linalg.inv(T), there, u) == pytest.approx(law_error(predict, K, look, u))
    assert horizon_errors(other, there, u, 1)[0] != pytest.approx(horizon_errors(predict, look, u, 1)[0], rel=0.1)


def test_noise_alone_explains_little_of_what_a_model_of_the_corridor_misses() -> None:
    policy = load_policy(find_policy("curved_corridor_edmd"))
    disturbances = {"none": Conditions(noise=0.0), "both": Conditions(dropout=0.1)}
    rows = ablate_disturbances(
        policy.closed_loop_model(), lambda each: make_world(policy, each), (0.5,), 1, disturbances
    )
    perfect, hard = rows
    assert [row["name"] for row in rows] == ["none", "both"]
    assert perfect["noise_floor"] < 1e-3, "two looks without noise are one"
    assert perfect["noise_floor"] < hard["noise_floor"] < hard["linear_floor"] < hard["model"]
    assert perfect["steps"] > 50
