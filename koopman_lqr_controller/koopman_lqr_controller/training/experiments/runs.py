"""The runs of thesis chapter 4: a learner on a task, from one seed, in chunks of actions.

result = train(LearningRun("cartpole_swingup", seed=0), RunOptions(Path("runs/mine"), 36, 500, 5, 20))
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from ctrl_rl_learning.study import IterationMetrics, ProgressCallback, Run, RunOptions, check_same, result_file

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.policy_file import digest
from koopman_lqr_controller.training.agents.learner import KoopmanLearner
from koopman_lqr_controller.training.agents.two_stage_learner import TwoStageLearner
from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
from koopman_lqr_controller.training.environments.benchmark_tasks import find_task
from koopman_lqr_controller.training.environments.task import BenchmarkTask, title_of
from koopman_lqr_controller.training.experiments.trainer import Keep, KoopmanTrainer, Learner


@dataclass(frozen=True)
class LearningRun(Run):
    """A run with a learner of `methods.LEARNERS`.

    Writes policy.safetensors, the kept policy, and optionally consolidated.safetensors to its folder. See
    `KoopmanTrainer` for the content of result and curve.

    Attributes:
        problem_name: Name of a task for `find_task`.
        seed: Random seed.
        changes: Changes to the problem's `Settings`, by name.
        device: Device of the networks: "cpu", with exactly reproducible runs, or "cuda".
        command: Command recorded in the policy file.
        consolidation: Episodes per round of consolidation, for a learnt LQR only; 0 for none.
        learner: One of `methods.LEARNERS`.
        keep: Policy to keep: the "best" in the evaluations after each chunk, or the "last".
    """

    problem_name: str
    seed: int
    changes: tuple[tuple[str, Any], ...] = ()
    device: str = "cpu"
    command: str = ""
    consolidation: int = 30
    learner: str = "koopman"
    keep: Keep = "best"

    @property
    def name(self) -> str:
        """Name of the run and of its folder."""
        learner = "" if self.learner == "koopman" else f"-{self.learner}"
        changes = "".join(f"-{name}_{value}" for name, value in self.changes)
        kept = "-last" if self.keep == "last" else ""
        return f"{title_of(self.problem_name)}{learner}{changes}{kept}-s{self.seed}"

    @property
    def problem(self) -> BenchmarkTask:
        """Problem with its settings.

        Raises:
            KoopmanError: The problem or a setting is unknown.
        """
        return find_task(self.problem_name).with_settings(**dict(self.changes))

    @property
    def description(self) -> dict[str, Any]:
        """Description of the run for its result and policy, as JSON."""
        problem = self.problem
        return {
            "task": problem.name,
            "task_digest": problem.digest,
            "learner": self.learner,
            "seed": self.seed,
            "device": self.device,
            "settings": problem.settings.as_json(),
        }

    def plan(self, options: RunOptions) -> ConsolidationConfig | None:
        """Return the consolidation settings; None for no consolidation."""
        if not self.consolidation or self.learner != "koopman" or self.problem.settings.policy != "lqr":
            return None
        return ConsolidationConfig.of(self.consolidation, options.final_evaluations)

    def fingerprint(self, options: RunOptions) -> dict[str, Any]:
        """Return description and settings.

        Raises:
            KoopmanError: The device does not exist.
        """
        if self.device != "cpu" and not torch.cuda.is_available():
            raise KoopmanError(f"device {self.device}: torch sees none; use cpu")
        plan = self.plan(options)
        names = ("iterations", "samples", "evaluations", "final_evaluations")
        budget = {name: getattr(options, name) for name in names}
        kept = {"keep": self.keep} if self.keep != "best" else {}  # keeps the digests of runs that predate this option
        return {**self.description, **budget, **kept, "consolidation": None if plan is None else plan.as_json()}

    @contextmanager
    def begin(self, options: RunOptions, tell: ProgressCallback) -> Iterator[KoopmanTrainer]:
        """Yield the trainer with its environments."""
        environment, tested = (self.problem.make(learning) for learning in (True, False))
        try:
            capacity = 2 * options.iterations * options.samples
            learner = _LEARNERS[self.learner](self.problem, environment, self.seed, capacity, self.device)
            manifest = {**self.description, "command": self.command}
            folder = result_file(options.folder, self).parent
            plan = self.plan(options)
            yield KoopmanTrainer(learner, self.problem, tested, options, folder, manifest, plan, self.keep, tell)
        finally:
            environment.close()
            tested.close()

    def words(self, point: IterationMetrics) -> str:
        """Format the return of the policy kept so far."""
        return f"{point['best']:.1f}"

    def should_stop(self, curve: Sequence[IterationMetrics]) -> bool:
        """Return whether a task's episode budget or its patience is exhausted."""
        # Other methods use the full budget: their curves may rise late, and ours must not benefit from an early stop.
        patience = self.problem.patience if self.learner == "koopman" else 0
        since_best = sum(point["actions"] > curve[-1]["best_actions"] for point in curve)
        used_up = self.problem.episodes and curve and curve[-1]["episodes"] >= self.problem.episodes
        return bool(used_up or (patience and since_best >= patience))

    def check(self, folder: Path, result: Mapping[str, Any]) -> None:
        """Raise if the policies of a finished run have been changed."""
        now = {name: digest(folder / name) for name in result["digests"]}
        check_same(result_file(folder.parent, self), result["digests"], now)


def _sac(*terms: Any) -> Learner:
    from koopman_lqr_controller.training.agents.sac_learner import SacLearner  # needed by this learner only

    return SacLearner(*terms)


_LEARNERS: Mapping[str, Callable[..., Learner]] = {
    "koopman": KoopmanLearner,
    "sac": _sac,
    "two_stage": TwoStageLearner,
    "edmd": partial(TwoStageLearner, learnt=False),
}
