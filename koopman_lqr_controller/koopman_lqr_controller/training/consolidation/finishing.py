"""What follows learning: the consolidated policy beside the learnt one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from koopman_lqr_controller.data.roll_outs import Environment, Episode
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import digest, load_policy
from koopman_lqr_controller.training.consolidation.consolidation import consolidate
from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
from koopman_lqr_controller.training.environments.benchmark_tasks import BenchmarkTask


def consolidate_policy(
    file: Path,
    problem: BenchmarkTask,
    environment: Environment,
    plan: ConsolidationConfig | None = None,
    command: str = "",
    seed: int = 0,
    on_progress: Callable[[str], None] = lambda _: None,
    reported: Sequence[Episode] | None = None,
) -> tuple[LatentPolicy, dict[str, Any]]:
    """Return the consolidated form of a learnt policy, and its figures.

    Args:
        file: File of the learnt policy.
        problem: Task that it was learnt in.
        environment: Environment of the task, to evaluate in.
        plan: Settings of the consolidation; the default ones unless given.
        command: Command that the policy records; the learnt one's where it is left out.
        seed: Seed of all episodes.
        on_progress: Takes words on the work at hand, as in `consolidate`.
        reported: Episodes of the learnt policy that `consolidate` need not run again.

    Raises:
        KoopmanError: the file holds no learnt policy, or there is no regulator.
    """
    learnt = load_latent(file)
    found = consolidate(learnt.controller, environment, plan, problem.goal is not None, seed, on_progress, reported)
    manifest = {
        **{name: value for name, value in learnt.manifest.items() if name not in ("returns", "outcomes")},
        "consolidated_from": digest(file),
        "command": command or learnt.manifest.get("command", ""),
        **found.figures,
    }
    return LatentPolicy(
        found.controller, learnt.dt, learnt.robot_interface, manifest, found.distribution
    ), found.figures


def load_latent(file: Path) -> LatentPolicy:
    """Return a learnt policy.

    Raises:
        KoopmanError: the file cannot be read, or its policy is of another kind.
    """
    policy = load_policy(file)
    if not isinstance(policy, LatentPolicy):
        raise KoopmanError(f"{file}: is a policy of fixed observables; this needs one that `learn` made")
    return policy
