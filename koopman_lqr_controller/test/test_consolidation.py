"""Consolidation on a linear system with known results."""

from dataclasses import replace

import numpy as np
import pytest
from koopman_lqr_controller.data.roll_outs import evaluate, noisy_roll_outs, projected
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.prediction import horizon_errors
from koopman_lqr_controller.training.consolidation.candidate_search import loss_bound
from koopman_lqr_controller.training.consolidation.consolidation import consolidate, regulator_figures
from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings, DistilledPolicy
from line import Line, learnt_controller

QUICK = DistillationSettings(hidden=64, updates=600, batch=128)
CONFIG = ConsolidationConfig(
    episodes=10,
    noise=0.3,
    rounds=2,
    exploratory_latent=3,
    sizes=(2, 3),
    candidates=5,
    report=10,
    distillation=QUICK,
    thorough=QUICK,
)


@pytest.fixture(scope="module")
def consolidated():
    return consolidate(learnt_controller(), Line(), CONFIG)


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


def test_its_model_predicts(consolidated) -> None:
    figures = consolidated.figures
    assert figures["error_over_persistence"] < 1 / 3
    assert figures["law_error"] < 1 / 3
    assert figures["learnt"]["error_over_persistence"] > 2 * figures["error_over_persistence"]
    assert len(consolidated.controller.Q) <= 3, "the system has three states"


def test_without_a_goal_it_stands_in_the_middle_of_what_is_met() -> None:
    found = consolidate(learnt_controller(), Line(), replace(CONFIG, sizes=(3,)), goal=False)
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
        consolidate(consolidated.controller, Line(), CONFIG)


def test_it_says_what_it_was_chosen_by_and_what_it_met(consolidated) -> None:
    figures = consolidated.figures
    assert figures["meets"] == {"return": True, "error": True}
    assert len(figures["horizon_errors"]) == 10
    assert figures["horizon_errors"][0] == figures["error_over_persistence"]
    tried = figures["candidates"]
    assert all(row["latent"] >= figures["latent"] for row in tried if row["error_over_persistence"] < CONFIG.error)
    assert tried[0]["latent"] == 3, "makes the mistakes that are learnt from"
    # 10 episodes in each of 2 rounds, 5 of the learnt policy and of each candidate, 60 steps each.
    assert figures["interaction"]["episodes"] == 20 + 5 * (1 + len(tried))
    assert figures["interaction"]["actions"] == 60 * figures["interaction"]["episodes"]


def test_a_return_is_kept_only_where_it_surely_is() -> None:
    same, falls_once = np.zeros(30), np.eye(30)[0] * 300.0
    assert loss_bound(same) == 0.0
    assert loss_bound(same - 3.0) == pytest.approx(-3.0), "more than the learnt one is no loss"
    assert loss_bound(falls_once) == pytest.approx(10.0 + 300.0 / 30.0)


def test_what_is_missed_is_said() -> None:
    small = ConsolidationConfig(episodes=10, noise=0.3, rounds=1, sizes=(3,), candidates=2, report=2)
    config = replace(small, error=0.0, distillation=replace(QUICK, updates=60), thorough=replace(QUICK, updates=30))
    assert consolidate(learnt_controller(), Line(), config).figures["meets"]["error"] is False


def test_where_the_usual_falls_short_the_larger_half_is_trained_more_thoroughly() -> None:
    hasty, many = replace(QUICK, updates=5), replace(QUICK, updates=1500)
    config = replace(CONFIG, rounds=1, sizes=(2, 3), max_return_loss=0.0, distillation=hasty, thorough=many)
    figures = consolidate(learnt_controller(), Line(), config).figures
    assert [(row["latent"], row["updates"]) for row in figures["candidates"]] == [(2, 5), (3, 5), (3, 1500)]
    assert figures["meets"] == {"return": True, "error": True}


def test_the_reported_error_is_of_episodes_that_nothing_was_chosen_by(consolidated) -> None:
    chosen = consolidated.controller
    noises = np.linspace(0.0, CONFIG.noise, 5).tolist()
    fresh = noisy_roll_outs(chosen, Line(), noises, 6_001_000)
    behind = replace(chosen.encoder, layers=chosen.encoder.layers[1:], shape=(8,), middle=np.zeros(8), unit=np.ones(8))
    for episode in noisy_roll_outs(learnt_controller(), Line(), noises, 6_000_000):
        fresh.append(replace(episode, features=behind(episode.features)))
    z, actions = projected(chosen.project, fresh)
    assert horizon_errors(chosen.predict, z, actions, 10) == pytest.approx(consolidated.figures["horizon_errors"])


def test_the_same_seed_gives_the_same_and_what_takes_long_is_told() -> None:
    hasty = replace(CONFIG, sizes=(3,), distillation=replace(QUICK, updates=60), error=2.0, tolerance=1.0)
    told: list[str] = []
    once, again = (consolidate(learnt_controller(), Line(), hasty, on_progress=tell) for tell in (len, told.append))
    assert told[:2] == ["the learnt policy", "10 episodes"]
    assert sum("dimensions" in each for each in told) == len(again.figures["candidates"])
    assert told[-3:] == ["the model's error", "10 fresh episodes", "10 fresh episodes"]
    assert np.array_equal(again.controller.K, once.controller.K)
    assert again.figures == once.figures


def test_a_learnt_controller_is_no_proof_of_itself() -> None:
    learnt = learnt_controller()
    with pytest.raises(KoopmanError, match="not the regulator of its own model"):
        regulator_figures(DistilledPolicy(learnt.encoder, learnt.encoder, learnt), [])


def test_the_sizes_are_those_that_were_asked_for() -> None:
    hasty = replace(QUICK, updates=60)
    config = ConsolidationConfig(
        episodes=10, noise=0.3, sizes=(5,), candidates=2, report=2, rounds=1, distillation=hasty, thorough=hasty
    )
    assert len(consolidate(learnt_controller(), Line(), config).controller.Q) == 5
