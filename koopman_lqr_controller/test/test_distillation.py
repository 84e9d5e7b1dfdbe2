"""New coordinates for a learnt policy, on a system that is linear in known coordinates."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import Episode, noisy_roll_outs, projected
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.models.encoder import Dense, Encoder
from koopman_lqr_controller.models.prediction import horizon_errors, law_error
from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings, distil

SETTINGS = DistillationSettings(hidden=64, updates=500, batch=128)
GOAL = np.zeros(2)


class SlowManifold:
    """Standard example of Koopman theory: x_1' = 0.95 x_1 + 0.1 u, x_2' = 0.8 x_2 + 0.15 x_1^2.

    Linear in x_1, x_2 and x_1^2 except for the controls, and in no two coordinates.
    """

    def reset(self, *, seed: int | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        self._x, self._steps = np.random.default_rng(seed).uniform(-1.0, 1.0, 2), 0
        return self._x, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        first, second = self._x
        self._x = np.array((0.95 * first + 0.1 * float(action[0]), 0.8 * second + 0.15 * first**2))
        self._steps += 1
        return self._x, -float(np.abs(self._x[1])), False, self._steps == 40, {}


def learnt_controller() -> LatentController:
    """Return a policy that acts well but has a useless model, as learning may leave it."""
    features = np.array([[1.0, 0.0], [0.5, 1.0], [-1.0, 0.4]], np.float32)
    encoder = Encoder(
        (Dense(features, np.zeros(3, np.float32), False),), (2,), np.zeros(2, np.float32), np.ones(2, np.float32)
    )
    model = LinearModel(1.2 * np.eye(3), np.array([[0.6], [0.1], [-0.5]]))
    return LatentController(encoder, model, np.ones(3), np.array([0.5]), features @ GOAL, horizon=3)


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    return noisy_roll_outs(learnt_controller(), SlowManifold(), np.linspace(0.0, 0.5, 30).tolist(), 0)


@pytest.fixture(scope="module")
def distilled(episodes):
    return distil(learnt_controller(), episodes, 3, True, SETTINGS)


@pytest.fixture(scope="module")
def fresh() -> list[Episode]:
    return noisy_roll_outs(learnt_controller(), SlowManifold(), [0.0, 0.1, 0.2, 0.4], 900)


def test_it_does_what_was_learnt(distilled, fresh) -> None:
    learnt = learnt_controller()
    psi = np.concatenate([episode.features for episode in fresh])
    wanted = learnt.saturate(learnt.control(psi))
    done = distilled.saturate(distilled.control(distilled.project(psi)))
    assert np.mean((done - wanted) ** 2) < 0.03 * np.var(wanted)


def test_its_model_predicts_where_that_of_the_learnt_does_not(distilled, fresh) -> None:
    learnt, controller = learnt_controller(), distilled.controller
    z, actions = projected(distilled.project, fresh)
    assert horizon_errors(learnt.predict, *projected(learnt.project, fresh), 1)[0] > 1.0
    errors = horizon_errors(controller.predict, z, actions, 10)
    assert errors[0] < 1 / 3
    assert errors[9] < 1 / 3, "and goes on predicting"
    assert law_error(controller.predict, controller.K, z, actions) < 1 / 3, "in what the law asks for too"


def test_it_is_the_infinite_horizon_lqr_of_its_own_model(distilled) -> None:
    controller = distilled.controller
    assert controller.horizon is None
    assert controller.spectral_radius < 1.0
    assert controller.residual < 1e-8
    assert controller.control(controller.z_ref) == pytest.approx(controller.a_ref)


def test_the_deployed_encoder_is_the_learnt_one_with_its_coordinates_behind(distilled) -> None:
    x = np.random.default_rng(0).normal(size=(20, 2))
    assert distilled.controller.latent(x) == pytest.approx(distilled.project(distilled.encoder(x)), abs=1e-5)


def test_a_goal_is_the_reference(distilled, episodes) -> None:
    learnt = learnt_controller()
    asked = distilled.control(distilled.project(learnt.z_ref))
    assert np.abs(asked).max() < 0.9, "so that it need not move"
    assert distilled.controller.z_ref == pytest.approx(distilled.project(learnt.z_ref))
    without = distil(learnt, episodes, 3, False, DistillationSettings(hidden=16, updates=200, batch=64)).controller
    assert without.control(without.z_ref) == pytest.approx(without.a_ref)


def test_the_same_seed_gives_the_same(episodes) -> None:
    short = DistillationSettings(hidden=16, updates=60, batch=64)
    one, again = (distil(learnt_controller(), episodes, 2, True, short) for _ in range(2))
    other = distil(learnt_controller(), episodes, 2, True, short, seed=1)
    assert np.array_equal(one.controller.K, again.controller.K)
    assert not np.array_equal(one.controller.K, other.controller.K)


class NearGoal(SlowManifold):
    """The same with starts a tenth as far away, where only noise causes large excursions."""

    def reset(self, *, seed: int | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._x = 0.1 * self._x
        return self._x, {}


def test_errors_on_quiet_episodes_do_not_drown_in_those_on_noisy_ones() -> None:
    learnt = learnt_controller()
    episodes = noisy_roll_outs(learnt, NearGoal(), np.linspace(0.0, 1.0, 30).tolist(), 0)
    quiet = noisy_roll_outs(learnt, NearGoal(), [0.0] * 10, 900)

    def error(groups: int, seed: int) -> float:
        found = distil(learnt, episodes, 2, True, replace(SETTINGS, updates=250, groups=groups), seed)
        return horizon_errors(found.controller.predict, *projected(found.project, quiet), 1)[0]

    together, apart = (sum(error(groups, seed) for seed in (0, 1)) for groups in (1, 3))
    assert apart < 0.95 * together


def test_too_short_episodes_are_refused() -> None:
    lone = Episode(np.zeros((2, 3)), np.zeros((1, 1)), 0.0, 1, 0.0, {})
    with pytest.raises(KoopmanError, match="no episode has 3 steps"):
        distil(learnt_controller(), [lone], 2, True, SETTINGS)
