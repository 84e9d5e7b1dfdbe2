"""What a run goes through, whatever learns: chunks of interaction, evaluations, and the best policy kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from ctrl_rl_training.array_file import load_arrays, save_arrays
from ctrl_rl_training.learner_state import Arrays
from ctrl_rl_training.resumable import Point

from koopman_lqr_controller.consolidation import REPORT_SEED, Plan
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.latent_policy import LatentPolicy
from koopman_lqr_controller.policy_file import digest, save_policy
from koopman_lqr_controller.roll_outs import Lived, evaluate, interaction, mean_return, outcomes
from koopman_lqr_controller.training.finishing import consolidate_policy, load_latent
from koopman_lqr_controller.training.problems import AnyEnvironment, Problem

POLICY_FILE = "policy.safetensors"
"""The best policy so far, in the folder of a run."""
CONSOLIDATED_FILE = "consolidated.safetensors"
"""What is deployed, in the folder of a run."""
_EVALUATION_SEED = 1_000_000


@dataclass(frozen=True)
class LearningOptions:
    """How runs go.

    Attributes:
        folder: where each has a folder of its own.
        iterations: chunks, at most.
        samples: actions of a chunk.
        evaluations: episodes after each chunk, for each candidate.
        final_evaluations: fresh episodes at the end.
    """

    folder: Path
    iterations: int
    samples: int
    evaluations: int = 5
    final_evaluations: int = 20


class Learner(Protocol):
    """What learns from interaction."""

    method: str

    def learn(self, chunk: int, done: int, actions: int, episodes: int) -> tuple[int, int]:
        """Act and learn.

        Args:
            chunk: its number: with the seed it decides all that is random.
            done: actions before it.
            actions: to do.
            episodes: to end with; 0 for any number.

        Returns:
            Actions done and episodes begun.
        """

    def candidates(self) -> dict[str, LatentController]:
        """Return what may be deployed now, by name; the first is what curves show."""

    def arrays(self) -> Arrays:
        """Return what it goes on from."""

    def restore(self, arrays: Arrays, /) -> None:
        """Take what `arrays` gave."""


class Course:
    """A learner as `resumable` wants it.

    Args:
        learner: learns.
        problem: that is learnt.
        tested: environment to evaluate in.
        options: how.
        folder: of the run.
        manifest: what policies say of themselves.
        plan: of consolidation, None for none.
    """

    def __init__(
        self,
        learner: Learner,
        problem: Problem,
        tested: AnyEnvironment,
        options: LearningOptions,
        folder: Path,
        manifest: Mapping[str, Any],
        plan: Plan | None,
    ) -> None:
        self._learner, self._problem, self._tested = learner, problem, tested
        self._options, self._folder, self._plan = options, folder, plan
        self._manifest = {**manifest, "method": learner.method}
        self._best: dict[str, Any] = {"return": -float("inf"), "actions": 0}
        self._curve: Sequence[Point] = ()

    def iterate(self, curve: Sequence[Point], /) -> Point:
        """Learn for one chunk, evaluate the candidates, and keep the best of them all.

        Returns:
            `actions` and `episodes` so far, `steps` of the system, `returns` of the candidates, `best` return so far
            and its `best_actions`, and what it took to find out: `evaluated`.
        """
        before = curve[-1] if curve else {"actions": 0, "episodes": 0}
        left = self._problem.episodes - before["episodes"] if self._problem.episodes else 0
        actions, episodes = self._learner.learn(len(curve), before["actions"], self._options.samples, left)
        done = before["actions"] + actions
        returns, evaluated = self._evaluate(done)
        return {
            "actions": done,
            "episodes": before["episodes"] + episodes,
            "steps": done * self._problem.repeat,
            "returns": returns,
            "best": self._best["return"],
            "best_actions": self._best["actions"],
            "evaluated": interaction(evaluated),
        }

    def _evaluate(self, actions: int) -> tuple[dict[str, float], list[Lived]]:
        returns: dict[str, float] = {}
        lived: list[Lived] = []
        for name, controller in self._learner.candidates().items():
            episodes = evaluate(controller, self._tested, self._options.evaluations, _EVALUATION_SEED)
            lived += episodes
            returns[name] = mean_return(episodes)
            if returns[name] > self._best["return"]:
                self._best = {"return": returns[name], "actions": actions, "which": name}
                wiring = getattr(self._tested, "wiring", None)
                policy = LatentPolicy(controller, self._tested.dt, wiring, {**self._manifest, **self._best})
                save_policy(policy, self._folder / POLICY_FILE, overwrite=True)
        return returns, lived

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint."""
        self._curve = progress["curve"]
        save_arrays(path, self._learner.arrays(), {**progress, "best": self._best})

    def load(self, path: Path, /) -> dict[str, Any]:
        """Go on from a checkpoint and return its progress."""
        arrays, progress = load_arrays(path)
        self._learner.restore(arrays)
        self._best, self._curve = progress.pop("best"), progress["curve"]
        return progress

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Evaluate the best policy on fresh episodes, and consolidate it where that is wanted.

        Returns:
            `best` (return, actions, which candidate), `interaction` (episodes and actions that were learnt from, and
            those that the best was chosen by), of fresh episodes `returns` and `outcomes`, `consolidated` (the figures
            of `Consolidated`, or None) and `digests` of the policies.
        """
        file = folder / POLICY_FILE
        policy = load_latent(file)
        fresh = evaluate(policy.controller, self._tested, self._options.final_evaluations, REPORT_SEED)
        last = {"returns": [episode.total for episode in fresh], "outcomes": outcomes(fresh)}
        save_policy(replace(policy, manifest={**policy.manifest, **last}), file, overwrite=True)
        files, consolidated = [file], None
        if self._plan is not None:
            files.append(folder / CONSOLIDATED_FILE)
            found, consolidated = consolidate_policy(file, self._problem, self._tested, self._plan, reported=fresh)
            save_policy(found, files[-1], overwrite=True)
        tested = [point["evaluated"] for point in self._curve]
        learning = {name: self._curve[-1][name] for name in ("episodes", "actions")}
        choosing = {name: sum(each[name] for each in tested) for name in ("episodes", "actions")}
        return {
            "best": self._best,
            "interaction": {"learning": learning, "choosing": choosing},
            **last,
            "consolidated": consolidated,
            "digests": {each.name: digest(each) for each in files},
        }


def over(curve: Sequence[Point], problem: Problem) -> bool:
    """Return whether the episodes or the patience of a task are used up."""
    if not curve:
        return False
    since_best = sum(point["actions"] > curve[-1]["best_actions"] for point in curve)
    return bool(
        (problem.episodes and curve[-1]["episodes"] >= problem.episodes)
        or (problem.patience and since_best >= problem.patience)
    )
