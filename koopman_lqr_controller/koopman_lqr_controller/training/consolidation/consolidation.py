"""After learning: a controller that is the LQR of its own model (beyond the thesis).

What learning leaves is a gain after a few Riccati iterations, on a model that serves the gain more than prediction: the
closed loop of that model is often not even stable. Consolidation keeps what the policy does and makes the rest true. It
runs noisy episodes and finds coordinates, a model, Q and R in which the infinite-horizon LQR does the same and the
model predicts (`distillation`). First it does so for an exploratory candidate, whose episodes hold new mistakes. It
then takes as few latent dimensions as keep the return and predict. The law is in units of actions, cut off at -1 and 1,
so that the loop of the proof is the loop that runs, and it proves itself: its gain is computed whenever it is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import (
    Environment,
    Episode,
    Policy,
)
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.safety.latent_distribution import LatentDistribution
from koopman_lqr_controller.training.consolidation.candidate_search import CandidateSearch
from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
from koopman_lqr_controller.training.consolidation.consolidation_report import report_figures


@dataclass(frozen=True)
class ConsolidationResult:
    """Result of a consolidation.

    Attributes:
        controller: With the infinite horizon.
        distribution: Distribution of the latents in the noisy episodes that its model was fitted to and chosen by.
        figures: Learnt and consolidated returns, and what control theory says, as JSON.
    """

    controller: LatentController
    distribution: LatentDistribution
    figures: dict[str, Any]


def consolidate(
    learnt: LatentController,
    environment: Environment,
    config: ConsolidationConfig | None = None,
    goal: bool = True,
    seed: int = 0,
    on_progress: Callable[[str], None] = lambda _: None,
    reported: Sequence[Episode] | None = None,
) -> ConsolidationResult:
    """Return the regulator that does what a learnt controller does.

    Args:
        learnt: Learnt controller, with a finite horizon.
        environment: Environment that it was learnt in.
        config: Settings of consolidation; the defaults where left out.
        goal: Whether z_ref is a goal; else the mean of the latents that are met takes its place.
        seed: Seed of all episodes.
        on_progress: Called with a line before each part and after each candidate.
        reported: Fresh episodes of the learnt controller from `REPORT_SEED` on, where there are some already; else it
            is evaluated.

    Raises:
        KoopmanError: no candidate has a regulator, or the controller is consolidated already.
    """
    if learnt.horizon is None:
        raise KoopmanError("this policy is the regulator of its own model already: give the one that `learn` made")
    config = config or ConsolidationConfig()
    search = CandidateSearch(learnt, environment, config, goal, seed, on_progress)
    acting: Policy = learnt
    for index in range(config.rounds):
        search.run(acting, index)
        if index < config.rounds - 1:
            acting = search.exploratory_candidate() or acting
    chosen = search.choose()
    figures = report_figures(search, chosen, reported)
    return ConsolidationResult(chosen.policy.controller, search.distribution(chosen.policy), figures)
