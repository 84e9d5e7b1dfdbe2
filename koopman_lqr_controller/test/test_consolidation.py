"""Consolidation on a linear system, where everything can be known."""

from typing import Any

import numpy as np
import pytest
from koopman_lqr_controller.consolidation import Plan, consolidate, proof
from koopman_lqr_controller.edmd import LinearModel
from koopman_lqr_controller.encoder import Dense, Encoder
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.regulators import Refit
from koopman_lqr_controller.roll_outs import evaluate, mean_return, noisy_roll_outs

A = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [0.0, 0.05, 0.95]])
B = np.array([[0.0], [0.1], [0.05]])
GOAL = np.array([0.5, 0.0, 0.0])  # an equilibrium: A GOAL = GOAL
PLAN = Plan(episodes=10, noise=0.3, sizes=(2, 3, 1000), candidates=5, report=10)


class Line:
    """x_{k+1} = A x_k + B u_k, to be brought to the goal within 60 steps; pays how near it is."""

    def reset(self, *, seed: int | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        self._x, self._steps = GOAL + 0.4 * np.random.default_rng(seed).normal(size=3), 0
        return self._x, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        paid = float(np.exp(-np.sum((self._x - GOAL) ** 2)))
        self._x, self._steps = A @ self._x + B @ action, self._steps + 1
        return self._x, paid, False, self._steps == 60, {"outcome": "GOAL" if paid > 0.9 else "TIMEOUT"}


def learnt_controller() -> LatentController:
    """Lift 3 states to 8 latent ones and regulate with a model that is wrong, as learning leaves it."""
    random = np.random.default_rng(0)
    lift = random.normal(size=(8, 3))
    encoder = Encoder(
        (Dense(lift.astype(np.float32), np.zeros(8, np.float32), False),),
        (3,),
        np.zeros(3, np.float32),
        np.ones(3, np.float32),
    )
    inverse = np.linalg.pinv(lift)
    model = LinearModel(1.1 * lift @ A @ inverse + 0.3 * random.normal(size=(8, 8)) / 8, lift @ B)
    return LatentController(encoder, model, np.ones(8), np.array([0.3]), lift @ GOAL, horizon=4)


@pytest.fixture(scope="module")
def consolidated():
    return consolidate(learnt_controller(), Line(), PLAN)


def test_it_keeps_the_return_and_says_both(consolidated) -> None:
    before, after = (float(np.mean(x["returns"])) for x in (consolidated.figures["learnt"], consolidated.figures))
    assert after >= 0.98 * before
    assert consolidated.figures["returns"] == [
        episode.total for episode in evaluate(consolidated.controller, Line(), 10, 5_000_000)
    ]
    assert set(consolidated.figures["outcomes"]) <= {"GOAL", "TIMEOUT"}


def test_it_is_the_regulator_of_its_own_model(consolidated) -> None:
    controller = consolidated.controller
    model, K, P = controller.model, controller.K, controller.P
    assert np.abs(np.linalg.eigvals(model.A - model.B @ K)).max() < 1.0
    Q, R = np.diag(controller.Q), np.diag(controller.R)
    riccati = model.A.T @ P @ (model.A - model.B @ K) + Q - P
    assert np.abs(riccati).max() < 1e-8 * max(1.0, np.abs(P).max())
    assert np.linalg.solve(R + model.B.T @ P @ model.B, model.B.T @ P @ model.A) == pytest.approx(K)
    assert controller.horizon is None
    assert controller.control(controller.z_ref) == pytest.approx(controller.a_ref)
    assert np.abs(controller.a_ref).max() <= 0.9


def test_the_offset_of_the_law_is_kept() -> None:
    """At its goal the learnt law, k - K z, asks for something: what comes of it asks for the same."""
    learnt = learnt_controller()
    lived = noisy_roll_outs(learnt, Line(), [0.0, 0.1, 0.2, 0.3], 0)
    found = Refit(learnt, lived, 1e-4, True).regulator("principal", np.linalg.qr(learnt.encoder.layers[0].weight)[0].T)
    psi = np.concatenate([episode.features for episode in lived])
    asked = learnt.control(psi)
    assert abs(float(learnt.control(learnt.z_ref)[0])) > 0.5
    assert np.abs(found.controller.control(found.controller.project(psi)) - asked).max() < 0.1 * np.ptp(asked)
    assert abs(np.mean(found.controller.control(found.controller.project(psi)) - asked)) < 0.05 * np.ptp(asked)


def test_its_model_is_that_of_the_system(consolidated) -> None:
    assert consolidated.figures["unreduced_horizon_errors"][0] < 0.05
    assert consolidated.figures["error_over_persistence"] < 0.15, "of two dimensions for three"
    assert consolidated.figures["learnt"]["error_over_persistence"] > 0.3
    assert len(consolidated.controller.Q) <= 3, "the system has three states"
    if len(consolidated.controller.Q) == 3:
        poles = np.sort_complex(np.linalg.eigvals(consolidated.controller.model.A))
        assert poles == pytest.approx(np.sort_complex(np.linalg.eigvals(A)), abs=0.02)


def test_without_a_goal_it_stands_in_the_middle_of_what_is_met() -> None:
    found = consolidate(learnt_controller(), Line(), PLAN, goal=False)
    before, after = (float(np.mean(x["returns"])) for x in (found.figures["learnt"], found.figures))
    assert after >= 0.95 * before
    assert found.figures["spectral_radius"] < 1.0
    controller, step = found.controller, 1e-5 * np.eye(len(found.controller.z_ref))

    def loop(dz: np.ndarray) -> np.ndarray:
        z = controller.z_ref + dz
        return controller.predict(z, controller.saturate(controller.control(z)))

    slopes = np.stack([(loop(each) - loop(-each)) / 2e-5 for each in step], axis=1)
    assert np.abs(np.linalg.eigvals(slopes)).max() < 1.0, "of the loop as it runs"
    assert (np.abs(controller.a_ref) <= 0.9).all()
    assert 0.0 <= found.figures["saturated"] < 1.0


def test_what_is_consolidated_is_not_consolidated_again(consolidated) -> None:
    with pytest.raises(KoopmanError, match="the regulator of its own model already"):
        consolidate(consolidated.controller, Line(), PLAN)


def test_it_says_what_it_was_chosen_by_and_what_it_met(consolidated) -> None:
    figures = consolidated.figures
    assert figures["meets"] == {"return": True, "error": True}
    assert figures["family"] == "observed", "what the law needs is tried first"
    assert len(figures["horizon_errors"]) == len(figures["unreduced_horizon_errors"]) == 10
    assert figures["horizon_errors"][0] == figures["error_over_persistence"]
    assert figures["contraction"] == 1.0
    tried = figures["candidates"]
    assert all(row["latent"] >= figures["latent"] for row in tried if row["error_over_persistence"] < PLAN.error)
    # 10 episodes in each of 2 rounds, 5 of the learnt policy and of each candidate, 60 steps each.
    assert figures["interaction"]["episodes"] == 20 + 5 * (1 + len(tried))
    assert figures["interaction"]["actions"] == 60 * figures["interaction"]["episodes"]


def test_what_is_missed_is_said() -> None:
    plan = Plan(episodes=10, noise=0.3, rounds=1, sizes=(1000,), candidates=2, report=2, error=0.0)
    assert consolidate(learnt_controller(), Line(), plan).figures["meets"] == {"return": True, "error": False}


def test_the_reported_error_is_of_episodes_that_nothing_was_chosen_by(consolidated) -> None:
    chosen = consolidated.controller
    noises = np.linspace(0.0, PLAN.noise, 2).tolist()
    fresh = noisy_roll_outs(learnt_controller(), Line(), noises, 6_000_000)
    fresh += noisy_roll_outs(chosen, Line(), noises, 6_001_000)
    assert proof(chosen, fresh)["horizon_errors"] == consolidated.figures["horizon_errors"]


def test_the_same_seed_gives_the_same_and_what_takes_long_is_told(consolidated) -> None:
    told: list[str] = []
    again = consolidate(learnt_controller(), Line(), PLAN, tick=told.append)
    assert told[:2] == ["the learnt policy", "10 episodes"]
    assert sum("dimensions" in each for each in told) == len(again.figures["candidates"])
    assert told[-3:] == ["the model's error", "10 fresh episodes", "10 fresh episodes"]
    assert np.array_equal(again.controller.K, consolidated.controller.K)
    assert again.figures == consolidated.figures


def test_a_learnt_controller_is_no_proof_of_itself() -> None:
    with pytest.raises(KoopmanError, match="not the regulator of its own model"):
        proof(learnt_controller(), [])


def test_a_reduced_controller_does_with_fewer_dimensions() -> None:
    found = consolidate(learnt_controller(), Line(), Plan(episodes=10, noise=0.3, sizes=(3,), candidates=5, report=5))
    assert found.controller.projection is not None
    assert found.controller.projection.shape == (3, 8)
    assert mean_return(evaluate(found.controller, Line(), 5, 0)) > 0.9 * mean_return(
        evaluate(learnt_controller(), Line(), 5, 0)
    )
