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
from pathlib import Path
from typing import Any

from ctrl_rl_core import DrivenRobot
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import (
    Episode,
    Policy,
    count_interaction,
    outcomes,
    projected,
    saturated,
)
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.prediction import HORIZON, horizon_errors, law_error
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import digest, load_policy
from koopman_lqr_controller.safety.guards import LatentDistribution
from koopman_lqr_controller.training.consolidation.candidate_search import Candidate, CandidateSearch, check_regulator
from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
from koopman_lqr_controller.training.consolidation.distillation import DistilledPolicy
from koopman_lqr_controller.training.environments.benchmark_tasks import BenchmarkTask


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
    environment: DrivenRobot[Any],
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
    figures = _figures(search, chosen, reported)
    return ConsolidationResult(chosen.policy.controller, search.distribution(chosen.policy), figures)


def _figures(search: CandidateSearch, chosen: Candidate, reported: Sequence[Episode] | None) -> dict[str, Any]:
    """Return the figures of the chosen candidate beside those of the learnt controller, as JSON."""
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


def consolidate_policy(
    file: Path,
    problem: BenchmarkTask,
    environment: DrivenRobot[Any],
    config: ConsolidationConfig,
    command: str = "",
    **how: Any,
) -> tuple[LatentPolicy, dict[str, Any]]:
    """Return the consolidated form of a learnt policy, and its figures.

    Args:
        file: File of the learnt policy.
        problem: Task that it was learnt in.
        environment: Environment of the task, to evaluate in.
        config: Settings of the consolidation.
        command: Command that the policy records; the learnt one's where it is left out.
        how: Other arguments of `consolidate`.

    Raises:
        KoopmanError: the file holds no learnt policy, or there is no regulator.
    """
    learnt = load_latent(file)
    found = consolidate(learnt.controller, environment, config, problem.goal is not None, **how)
    manifest = {
        **{name: value for name, value in learnt.manifest.items() if name not in ("returns", "outcomes")},
        "consolidated_from": digest(file),
        "command": command or learnt.manifest.get("command", ""),
        **found.figures,
    }
    policy = LatentPolicy(found.controller, learnt.dt, learnt.robot_interface, manifest, found.distribution)
    return policy, found.figures


def load_latent(file: Path) -> LatentPolicy:
    """Return a learnt policy.

    Raises:
        KoopmanError: the file cannot be read, or its policy is of another kind.
    """
    policy = load_policy(file)
    if not isinstance(policy, LatentPolicy):
        raise KoopmanError(f"{file}: is a policy of fixed observables; this needs one that `learn` made")
    return policy
