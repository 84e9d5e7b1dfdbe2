"""Success and return of a learnt policy in new episodes."""

from __future__ import annotations

from pathlib import Path

from ctrl_rl_learning.cli import EvaluateOptions, report

from ctrl_rl_core import Outcome
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import evaluate
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.agents.network_policy import NetworkPolicy
from koopman_lqr_controller.training.consolidation.consolidation import load_latent
from koopman_lqr_controller.training.environments.benchmark_tasks import find_task, task_of_manifest


def evaluate_in_episodes(policy: Path, task: str | None, episodes: int, seed: int, results: Path | None) -> int:
    """Run the episodes `seed`, `seed` + 1, etc., report them as `ctrl_rl_learning.cli.evaluate`, and return 0.

    Raises:
        KoopmanError: The file has no policy learnt by `train`, or its task is unknown or has changed.
    """
    controller: NetworkPolicy | LatentController
    try:
        controller = NetworkPolicy.load(policy)
        manifest = controller.manifest
    except KoopmanError:
        latent = load_latent(policy)
        controller, manifest = latent.controller, latent.manifest
    problem = task_of_manifest(manifest) if task is None else find_task(task)
    environment = problem.make(False)
    try:
        played = evaluate(controller, environment, episodes, seed)
    finally:
        environment.close()
    ends = [episode.info.get("outcome") for episode in played]
    succeeded = None if None in ends else [end == Outcome.GOAL.name for end in ends]
    options = EvaluateOptions(policy=policy, task=task, episodes=episodes, seed=seed, results=results)
    return report(options, problem.title, succeeded, [episode.total for episode in played])
