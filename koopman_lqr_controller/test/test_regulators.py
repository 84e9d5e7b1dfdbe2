"""The regulator of a refitted model agrees with the learnt law."""

import numpy as np
import pytest
from koopman_lqr_controller.data.roll_outs import noisy_roll_outs, projected
from koopman_lqr_controller.identification.regulators import RegulatorFitter, reference_inside
from koopman_lqr_controller.models.prediction import horizon_errors
from line import A, Line, learnt_controller


def test_the_offset_of_the_law_is_kept() -> None:
    """At its goal the learnt law k - K z has a nonzero control; the refitted law has the same."""
    learnt = learnt_controller()
    lived = noisy_roll_outs(learnt, Line(), [0.0, 0.1, 0.2, 0.3], 0)
    found = RegulatorFitter(learnt, lived, (), True).regulator(
        "principal", np.linalg.qr(learnt.encoder.layers[0].weight)[0].T
    )
    psi = np.concatenate([episode.features for episode in lived])
    asked = learnt.control(psi)
    assert abs(float(learnt.control(learnt.z_ref)[0])) > 0.5
    missed = found.controller.control(found.controller.project(psi)) - asked
    assert np.abs(missed).max() < 0.1 * np.ptp(asked)
    assert abs(missed.mean()) < 0.05 * np.ptp(asked)


def test_the_refitted_model_is_that_of_the_system() -> None:
    learnt = learnt_controller()
    lived = noisy_roll_outs(learnt, Line(), np.linspace(0.0, 0.3, 10).tolist(), 0)
    lift = np.linalg.qr(learnt.encoder.layers[0].weight)[0].T
    found = RegulatorFitter(learnt, lived, (), True).regulator("principal", lift).controller
    fresh = noisy_roll_outs(learnt, Line(), [0.0, 0.3], 900)
    assert horizon_errors(found.predict, *projected(found.project, fresh), 10)[0] < 0.05
    assert np.sort_complex(np.linalg.eigvals(found.model.A)) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(A)), abs=0.02
    )


def test_a_reference_moves_to_where_its_action_can_be_done() -> None:
    random = np.random.default_rng(0)
    K, z_ref = random.normal(size=(2, 5)), random.normal(size=5)
    factor = random.normal(size=(5, 5))
    moved, action = reference_inside(z_ref, np.array((2.0, -0.3)), K, factor @ factor.T)
    assert action == pytest.approx((0.9, -0.3))
    assert np.array((2.0, -0.3)) - K @ (moved - z_ref) == pytest.approx(action), "the law is the same"
    stays, action = reference_inside(z_ref, np.array((0.2, -0.3)), K, factor @ factor.T)
    assert stays == pytest.approx(z_ref)
    assert action == pytest.approx((0.2, -0.3))
