"""Learning by interaction with any learner: chunks, evaluations after each, and the best or last policy kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from ctrl_rl_core.io import Schema
from ctrl_rl_learning.study import IterationMetrics, ProgressCallback, RunOptions
from ctrl_rl_learning.torch import Arrays, load_arrays, save_arrays
from pydantic import ConfigDict, Field

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import Episode, count_interaction, evaluate, mean_return, outcomes, projected
from koopman_lqr_controller.models.prediction import horizon_errors, squared_error
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import digest, save_policy
from koopman_lqr_controller.safety.guards import LatentDistribution, fit_distribution
from koopman_lqr_controller.training.agents.network_policy import NetworkPolicy
from koopman_lqr_controller.training.consolidation.consolidation import consolidate_policy, load_latent
from koopman_lqr_controller.training.consolidation.consolidation_config import REPORT_SEED, ConsolidationConfig
from koopman_lqr_controller.training.environments.task import AnyEnvironment, BenchmarkTask
from koopman_lqr_controller.training.replay import Replay

Keep = Literal["best", "last"]
"""Policy to keep: the best in the evaluations, or the last."""
POLICY_FILE = "policy.safetensors"
"""File of the kept policy in the folder of a run."""
CONSOLIDATED_FILE = "consolidated.safetensors"
"""File of the deployed policy in the folder of a run."""
_EVALUATION_SEED = 1_000_000
_MOST_FOR_REGION = 10_000
"""Number of steps sufficient to estimate the training distribution."""


class _Best(Schema):
    """The policy kept so far, as stored in a checkpoint."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    returned: float = Field(alias="return")
    actions: int
    kind: str | None = None


class _Point(Schema):
    """Data of a chunk needed to resume, see `KoopmanTrainer.iterate`."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    actions: int
    episodes: int
    best_actions: int


class Learner(Protocol):
    """Protocol of learners that learn from interaction."""

    method: str

    @property
    def replay(self) -> Replay | None:
        """Steps stored so far; None if a library manages its own replay."""

    def learn(self, chunk: int, done: int, actions: int, episodes: int) -> tuple[int, int]:
        """Act and learn for one chunk; return the numbers of actions executed and episodes started."""

    def take_losses(self) -> dict[str, float]:
        """Return the mean losses since the last call, by name, and the policy's entropy if it has one."""

    def candidates(self) -> Mapping[str, LatentController | NetworkPolicy]:
        """Return the deployable policies by name; the first is the one kept as last, and shown in curves."""

    def arrays(self) -> Arrays:
        """Return the state for resuming."""

    def restore(self, arrays: Arrays, /) -> None:
        """Restore the state returned by `arrays`."""


class KoopmanTrainer:
    """A learner as a `Trainer`: chunks of interaction, evaluations, and one policy kept.

    Args:
        learner: Learner of the run.
        problem: Problem to learn.
        tested: Evaluation environment.
        options: Settings of the experiment.
        folder: Folder of the run.
        manifest: Description of the run for its policies.
        plan: Settings of the consolidation; None for none.
        keep: Policy to keep: the "best" of all candidates in the evaluations, or the "last" first candidate.
        tell: Called with the number of finished chunks, and the current work if it is not a chunk.
    """

    def __init__(
        self,
        learner: Learner,
        problem: BenchmarkTask,
        tested: AnyEnvironment,
        options: RunOptions,
        folder: Path,
        manifest: Mapping[str, Any],
        plan: ConsolidationConfig | None,
        keep: Keep = "best",
        tell: ProgressCallback = lambda *_: None,
    ) -> None:
        self._learner, self._problem, self._tested = learner, problem, tested
        self._options, self._folder, self._plan, self._tell = options, folder, plan, tell
        self._keep = keep
        self._manifest = {**manifest, "method": learner.method}
        self._best: dict[str, Any] = {"return": -float("inf"), "actions": 0}
        self._curve: Sequence[IterationMetrics] = ()

    def iterate(self, curve: Sequence[IterationMetrics], /) -> IterationMetrics:
        """Learn for one chunk, evaluate the candidates, and keep the best or the last.

        Returns:
            `actions` and `episodes` so far, `steps` of the simulation, `returns` and `model_errors` of the candidates
            (see `model_errors`), `best`, the return of the kept policy, its `best_actions`, `evaluated`, the episodes
            and actions used by these evaluations, and `losses`.
        """
        before = curve[-1] if curve else {"actions": 0, "episodes": 0}
        problem = self._problem
        left = problem.episodes - before["episodes"] if problem.episodes else 0
        most = min(filter(None, (left, problem.chunk_episodes)), default=0)
        actions, episodes = self._learner.learn(len(curve), before["actions"], self._options.samples, most)
        done = before["actions"] + actions
        returns, errors, evaluated = self._evaluate(done)
        return {
            "actions": done,
            "episodes": before["episodes"] + episodes,
            "steps": done * problem.repeat,
            "returns": returns,
            "model_errors": errors,
            "best": self._best["return"],
            "best_actions": self._best["actions"],
            "evaluated": count_interaction(evaluated),
            "losses": self._learner.take_losses(),
        }

    def _evaluate(self, actions: int) -> tuple[dict[str, float], dict[str, float], list[Episode]]:
        """Return the candidates' returns and model errors, and the episodes used."""
        returns: dict[str, float] = {}
        errors: dict[str, float] = {}
        everything: list[Episode] = []
        for place, (name, controller) in enumerate(self._learner.candidates().items()):
            episodes = evaluate(controller, self._tested, self._options.evaluations, _EVALUATION_SEED, keep=True)
            everything += episodes
            returns[name] = mean_return(episodes)
            if isinstance(controller, LatentController):
                errors[name] = model_errors(controller, episodes)["model_error"]
            if place == 0 if self._keep == "last" else returns[name] > self._best["return"]:
                self._best = {
                    "return": returns[name],
                    "actions": actions,
                    "which": name,
                    "kind": type(controller).__name__,
                }
                self._write(controller, {**self._manifest, **self._best})
        return returns, errors, everything

    def _write(
        self,
        controller: LatentController | NetworkPolicy,
        manifest: Mapping[str, Any],
        distribution: LatentDistribution | None = None,
    ) -> None:
        file = self._folder / POLICY_FILE
        if isinstance(controller, NetworkPolicy):
            replace(controller, manifest=manifest).save(file)
        else:
            robot_interface = getattr(self._tested, "robot_interface", None)
            save_policy(
                LatentPolicy(controller, self._tested.dt, robot_interface, manifest, distribution), file, overwrite=True
            )

    def _read(self) -> tuple[LatentController | NetworkPolicy, Mapping[str, Any]]:
        """Read the kept policy and its manifest."""
        file = self._folder / POLICY_FILE
        if self._best["kind"] == NetworkPolicy.__name__:
            network = NetworkPolicy.load(file)
            return network, network.manifest
        policy = load_latent(file)
        return policy.controller, policy.manifest

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint."""
        self._curve = progress["curve"]
        save_arrays(path, self._learner.arrays(), {**progress, "best": self._best})

    def load(self, path: Path, /) -> dict[str, Any]:
        """Load a checkpoint and return its progress."""
        arrays, progress = load_arrays(path)
        self._learner.restore(arrays)
        best, self._curve = progress.pop("best"), progress["curve"]
        self._best = _Best.model_validate(best).model_dump(by_alias=True, exclude_unset=True)
        for point in self._curve:
            _Point.model_validate(point)
        return progress

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Evaluate the kept policy on new episodes, and optionally consolidate it.

        Returns:
            `best` (return, actions, candidate), `interaction` (episodes and actions used for training and for
            selection, none for the last policy), from new episodes `returns`, `outcomes` and, with a model, the metrics
            of `model_errors`, `consolidated` (the metrics of consolidation, or None) and `digests` of the policies.
        """
        file, files, consolidated = folder / POLICY_FILE, [POLICY_FILE], None
        controller, manifest = self._read()
        self._report_progress("fresh episodes")
        fresh = evaluate(controller, self._tested, self._options.final_evaluations, REPORT_SEED, keep=True)
        last: dict[str, Any] = {"returns": [episode.total for episode in fresh], "outcomes": outcomes(fresh)}
        self._write(controller, {**manifest, **last}, self._distribution(controller))
        if isinstance(controller, LatentController):
            last |= model_errors(controller, fresh)
            if self._plan is not None and controller.horizon is not None:
                found, consolidated = consolidate_policy(
                    file,
                    self._problem,
                    self._tested,
                    self._plan,
                    on_progress=lambda what: self._report_progress(f"consolidating, {what}"),
                    reported=fresh,
                )
                save_policy(found, folder / CONSOLIDATED_FILE, overwrite=True)
                files.append(CONSOLIDATED_FILE)
        tested = [] if self._keep == "last" else [point["evaluated"] for point in self._curve]
        learning = {name: self._curve[-1][name] for name in ("episodes", "actions")}
        choosing = {name: sum(each[name] for each in tested) for name in ("episodes", "actions")}
        return {
            "best": self._best,
            "interaction": {"learning": learning, "choosing": choosing},
            **last,
            "consolidated": consolidated,
            "digests": {name: digest(folder / name) for name in files},
        }

    def _report_progress(self, what: str) -> None:
        self._tell(len(self._curve), what)

    def _distribution(self, controller: LatentController | NetworkPolicy) -> LatentDistribution | None:
        """Return the training distribution in a policy's latents; None for images and policies without latents."""
        replay = self._learner.replay
        if replay is None or self._problem.settings.crop or not isinstance(controller, LatentController):
            return None
        steps = replay.draw(_MOST_FOR_REGION, np.random.default_rng(0))
        z, z_next = controller.latent(steps.x), controller.latent(steps.x_next)
        predicted = controller.predict(z, steps.u.astype(np.float64))
        return fit_distribution(z, np.linalg.norm(z_next - predicted, axis=1))


def model_errors(controller: LatentController, episodes: Sequence[Episode]) -> dict[str, float]:
    """Return the one-step errors of a model on noise-free episodes.

    Returns:
        `model_error`, the mean squared error over all latent components, and `error_over_persistence`, see
        `horizon_errors`.
    """
    z, actions = projected(controller.project, episodes)
    return {
        "model_error": squared_error(controller.predict, z, actions),
        "error_over_persistence": horizon_errors(controller.predict, z, actions, 1)[0],
    }
