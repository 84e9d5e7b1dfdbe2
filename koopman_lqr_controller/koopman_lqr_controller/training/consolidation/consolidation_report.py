"""The figures of a consolidation: returns, and the checks that a policy is the LQR of a model that predicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import (
    Episode,
    count_interaction,
    outcomes,
    projected,
    saturated,
)
from koopman_lqr_controller.models.prediction import HORIZON, horizon_errors, law_error
from koopman_lqr_controller.training.consolidation.candidate_search import Candidate, CandidateSearch, check_regulator
from koopman_lqr_controller.training.consolidation.distillation import DistilledPolicy


def report_figures(
    search: CandidateSearch, chosen: Candidate, reported: Sequence[Episode] | None = None
) -> dict[str, Any]:
    """Return the figures of the chosen candidate beside those of the learnt controller, as JSON.

    Args:
        search: Search that is finished.
        chosen: Candidate that the search chose.
        reported: Fresh episodes of the learnt controller from `REPORT_SEED` on; it is evaluated where this is None.

    Raises:
        KoopmanError: the candidate is not the regulator of its own model.
    """
    learnt, controller = search.learnt, chosen.policy.controller
    measured = search.measure(chosen.policy)
    before = search.report(learnt) if reported is None else reported
    after = search.report(controller)
    return {
        "returns": [episode.total for episode in after],
        "outcomes": outcomes(after),
        "meets": chosen.meets(search.learnt_score, search.config),
        "latent": len(controller.Q),
        "saturated": saturated(after),
        **regulator_figures(chosen.policy, measured),
        "learnt": {
            "returns": [episode.total for episode in before],
            "outcomes": outcomes(before),
            "saturated": saturated(before),
            "spectral_radius": learnt.spectral_radius,
            **_errors(learnt, *projected(learnt.project, measured), 1),
        },
        "interaction": count_interaction(search.all_episodes),
        "candidates": [each.row() for each in search.tried],
    }


def regulator_figures(policy: DistilledPolicy, episodes: Sequence[Episode]) -> dict[str, Any]:
    """Return what shows that a policy is the LQR of its own model, and that the model predicts.

    Args:
        policy: As it was found.
        episodes: With the features of the learnt policy.

    Raises:
        KoopmanError: it is not.
    """
    controller = policy.controller
    check_regulator(controller)
    return {
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
        **_errors(controller, *projected(policy.project, episodes), HORIZON),
    }


def _errors(controller: LatentController, z: Sequence[Array], actions: Sequence[Array], steps: int) -> dict[str, Any]:
    """Return how far the model is off over persistence: in z, after so many steps where more than one, and in K z."""
    errors = horizon_errors(controller.predict, z, actions, steps)
    return {
        "error_over_persistence": errors[0],
        **({"horizon_errors": errors} if steps > 1 else {}),
        "law_error": law_error(controller.predict, controller.K, z, actions),
    }
