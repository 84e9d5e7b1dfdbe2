"""Converts a learnt controller to the LQR of its own model after training (beyond the thesis).

Learning yields a gain after a few Riccati iterations, for a model that serves the gain more than prediction: its closed
loop is often not even stable. Consolidation keeps the policy's behaviour and makes model and regulator consistent. It
runs noisy episodes and finds coordinates, a model, Q and R for which the infinite-horizon LQR acts the same and the
model predicts well (`distillation`). This is first done for an exploratory candidate, whose episodes contain new
mistakes. The result has the smallest latent dimension that keeps the return and predicts well. The law is in units of
actions, clipped to [-1, 1], so the analysed loop is the deployed loop, and its gain is recomputed whenever it is
loaded.
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
from koopman_lqr_controller.training.environments.task import BenchmarkTask


@dataclass(frozen=True)
class ConsolidationResult:
    """Result of a consolidation.

    Attributes:
        controller: Infinite-horizon controller.
        distribution: Distribution of the latents in the noisy episodes used for fit and selection.
        figures: Learnt and consolidated returns, and control-theoretic metrics, as JSON.
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
    """Return the regulator equivalent to a learnt controller.

    Args:
        learnt: Learnt controller, with a finite horizon.
        environment: Training environment.
        config: Settings of consolidation; the default ones if omitted.
        goal: Whether z_ref is a goal; otherwise the mean of the observed latents is used.
        seed: Random seed of all episodes.
        on_progress: Called with a line before each part and after each candidate.
        reported: Existing new episodes of the learnt controller from `REPORT_SEED` on; by default they are run.

    Raises:
        KoopmanError: No candidate has a regulator, or the controller is already consolidated.
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
    """Return the metrics of the chosen candidate and of the learnt controller, as JSON."""
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
    """Return metrics showing that a policy is the LQR of its own model, and that the model predicts well.

    Args:
        policy: Policy to check.
        episodes: Episodes with the features of the learnt policy.

    Raises:
        KoopmanError: The policy is not the LQR of its own model.
    """
    controller = policy.controller
    check_regulator(controller)
    return {
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
        **_errors(controller, *projected(policy.project, episodes), HORIZON),
    }


def _errors(controller: LatentController, z: Sequence[Array], actions: Sequence[Array], steps: int) -> dict[str, Any]:
    """Return the model's errors relative to persistence: in z after one or more steps, and in K z."""
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
    """Return the consolidated form of a learnt policy, and its metrics.

    Args:
        file: File of the learnt policy.
        problem: Task of the learnt policy.
        environment: Evaluation environment of the task.
        config: Settings of the consolidation.
        command: Command recorded in the policy; by default that of the learnt policy.
        how: Further arguments of `consolidate`.

    Raises:
        KoopmanError: The file has no learnt policy, or there is no regulator.
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
    """Load a learnt policy.

    Raises:
        KoopmanError: The file cannot be read, or its policy is of another kind.
    """
    policy = load_policy(file)
    if not isinstance(policy, LatentPolicy):
        raise KoopmanError(f"{file}: is a policy of fixed observables; this needs one that `learn` made")
    return policy
