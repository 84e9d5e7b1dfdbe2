"""One run of learning: a method on a task, from one seed; may be cut off at any time.

    result = learn_one(LearningRun("cartpole_swingup", seed=0), LearningOptions(Path("runs/mine"), 36, 500))

It goes in chunks of actions. Each begins a fresh episode and draws its random numbers from the seed and its own number,
so that a run that goes on from its last checkpoint ends exactly as if it had not been cut off.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from ctrl_rl_training.experiments.resumable import Point, resumable
from ctrl_rl_training.experiments.run_folder import check_same, result_file

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.policy_file import digest
from koopman_lqr_controller.training.agents.learner import KoopmanLearner
from koopman_lqr_controller.training.agents.two_stage_learner import TwoStageLearner
from koopman_lqr_controller.training.consolidation.consolidation import Plan
from koopman_lqr_controller.training.environments.problems import Problem, find_problem
from koopman_lqr_controller.training.experiments.trainer import Course, Learner, LearningOptions, over


@dataclass(frozen=True)
class LearningRun:
    """What is learnt: everything about it, and nothing that cannot be sent to another process.

    Attributes:
        problem_name: one of `PROBLEMS`, or the .yaml file of a task with a corridor.
        seed: of everything random.
        changes: of the problem's `Settings`, by name.
        device: of the networks: "cpu", whose runs can be repeated exactly, or "cuda".
        command: that made it, for the policy file.
        consolidation: episodes of each round of consolidation; 0 for none, and none unless an LQR was learnt.
        learner: one of `methods.LEARNERS`.
    """

    problem_name: str
    seed: int
    changes: tuple[tuple[str, Any], ...] = ()
    device: str = "cpu"
    command: str = ""
    consolidation: int = 30
    learner: str = "koopman"

    @property
    def name(self) -> str:
        """Its name, which is that of its folder too."""
        learner = "" if self.learner == "koopman" else f"-{self.learner}"
        changes = "".join(f"-{name}_{value}" for name, value in self.changes)
        return f"{Path(self.problem_name).stem}{learner}{changes}-s{self.seed}"

    @property
    def problem(self) -> Problem:
        """The problem with its settings.

        Raises:
            KoopmanError: there is no such problem or setting.
        """
        return find_problem(self.problem_name).with_settings(**dict(self.changes))

    @property
    def description(self) -> dict[str, Any]:
        """What results and policy say about it, as JSON."""
        problem = self.problem
        return {
            "task": problem.name,
            "task_digest": problem.digest,
            "learner": self.learner,
            "seed": self.seed,
            "device": self.device,
            "settings": problem.settings.as_json(),
        }


Report = Callable[[LearningRun, int, float | str], None]


def learn_one(run: LearningRun, options: LearningOptions, report: Report = lambda *_: None) -> dict[str, Any]:
    """Learn, or go on where an earlier call was cut off; a finished run is read, never computed again.

    The folder of the run then holds result.json (what is returned), policy.safetensors, the policy that was best in the
    evaluations after each chunk, and consolidated.safetensors, unless the run wants none.

    Args:
        run: what is learnt.
        options: how.
        report: called after each chunk with the best return so far, and at the end with what is done then.

    Returns:
        `run` (its terms), `curve` (what `Course.iterate` says of each chunk), what `Course.finish` says, `digests` of
        the policies, and `cpu_seconds`.

    Raises:
        CtrlRlError: the run asks for what is not there, or its files are of another run.
    """
    torch.set_num_threads(1)
    if run.device != "cpu" and not torch.cuda.is_available():
        raise KoopmanError(f"device {run.device}: torch sees none; use cpu")
    regulated = run.learner == "koopman" and run.problem.settings.policy == "lqr"
    plan = Plan.of(run.consolidation, options.final_evaluations) if run.consolidation and regulated else None
    # What others offer has all of the budget: their curves may rise late, and ours must not win by that.
    patience = run.problem.patience if run.learner == "koopman" else 0
    terms = {
        **run.description,
        "iterations": options.iterations,
        "samples": options.samples,
        "evaluations": options.evaluations,
        "final_evaluations": options.final_evaluations,
        "consolidation": None if plan is None else asdict(plan),
    }

    @contextmanager
    def begin() -> Iterator[Course]:
        environments = [run.problem.make(learning) for learning in (True, False)]
        try:
            yield _course(run, options, plan, lambda done, what: report(run, done, what), *environments)
        finally:
            for environment in environments:
                environment.close()

    def tell(done: int, point: Point) -> None:
        report(run, done, f"{point['best']:.1f}")

    result = resumable(
        run,
        options.folder,
        options.iterations,
        json.loads(json.dumps(terms)),
        begin,
        tell,
        lambda curve: over(curve, run.problem, patience),
    )
    _check_policies(run, options, result)
    return result


def _sac(*terms: Any) -> Learner:
    from koopman_lqr_controller.training.agents.sac_learner import SacLearner  # its library is for no other learner

    return SacLearner(*terms)


_LEARNERS: Mapping[str, Callable[..., Learner]] = {
    "koopman": KoopmanLearner,
    "sac": _sac,
    "two_stage": TwoStageLearner,
    "edmd": partial(TwoStageLearner, learnt=False),
}


def _course(
    run: LearningRun,
    options: LearningOptions,
    plan: Plan | None,
    tell: Callable[[int, str], None],
    environment: Any,
    tested: Any,
) -> Course:
    capacity = 2 * options.iterations * options.samples
    learner = _LEARNERS[run.learner](run.problem, environment, run.seed, capacity, run.device)
    manifest = {**run.description, "command": run.command}
    folder = result_file(options.folder, run).parent
    return Course(learner, run.problem, tested, options, folder, manifest, plan, tell)


def _check_policies(run: LearningRun, options: LearningOptions, result: dict[str, Any]) -> None:
    """Refuse a finished run whose policies are others than when it ended."""
    file = result_file(options.folder, run)
    now = {name: digest(file.with_name(name)) for name in result["digests"]}
    check_same(file, result["digests"], now)
