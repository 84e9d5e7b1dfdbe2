"""What follows learning: the consolidated policy beside the learnt one, and what all runs of a task amount to."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.results import Result
from ctrl_rl_core.whole_file import write_whole
from ctrl_rl_training.run_folder import Options, Report, check_same, result_file

from koopman_lqr_controller.consolidation import Plan, consolidate
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_policy import LatentPolicy
from koopman_lqr_controller.policy_file import digest, load_policy, save_policy
from koopman_lqr_controller.training.learner import POLICY_FILE, LearningRun, learn_one, terms
from koopman_lqr_controller.training.problems import Problem

CONSOLIDATED_FILE = "consolidated.safetensors"
"""What is deployed, in the folder of a run."""
_LEARNT, _CONSOLIDATED = "task-oriented Koopman", "task-oriented Koopman, consolidated"


def learn_and_consolidate(run: LearningRun, options: Options, report: Report = lambda *_: None, /) -> dict[str, Any]:
    """Do what `learn_one` does, then consolidate; what is done is read where it is there.

    The folder of the run then holds what `learn_one` leaves, consolidated.safetensors, and result.json, which is
    returned: it is written last, so that what was cut off on the way goes on.

    Returns:
        What `learn_one` returns, `consolidated`: the figures of `Consolidated`, and `digests` of both policies.

    Raises:
        CtrlRlError: the run asks for what is not there, or its files are of another run.
    """
    finished = result_file(options.folder, run)
    policies = [finished.with_name(name) for name in (POLICY_FILE, CONSOLIDATED_FILE)]
    plan = Plan.of(run.consolidation, options.final_evaluations)
    now = json.loads(json.dumps({**terms(run, options), "plan": asdict(plan)}))
    if finished.is_file():
        result: dict[str, Any] = json.loads(finished.read_text(encoding="utf-8"))
        check_same(finished, result["run"], now)
        check_same(finished, result["digests"], {file.name: digest(file) for file in policies})
        return result
    result = learn_one(run, options, report)
    policy, found = consolidate_policy(policies[0], run.problem, run.command, plan)
    save_policy(policy, policies[1], overwrite=True)
    digests = {file.name: digest(file) for file in policies}
    result = {**result, "run": now, "consolidated": found, "digests": digests}
    write_whole(finished, json.dumps(result) + "\n")
    return result


def consolidate_policy(
    file: Path,
    problem: Problem,
    command: str,
    plan: Plan | None = None,
    seed: int = 0,
    tick: Callable[[str], None] = lambda _: None,
) -> tuple[LatentPolicy, dict[str, Any]]:
    """Return the consolidated form of a learnt policy, and its figures.

    Args:
        file: of the learnt policy.
        problem: that it was learnt in.
        command: that is noted in the policy.
        plan: how.
        seed: of all episodes.
        tick: see `consolidate`.

    Raises:
        KoopmanError: the file holds no learnt policy, or there is no regulator.
    """
    learnt = load_latent(file)
    environment = problem.make(False)
    try:
        found = consolidate(learnt.controller, environment, plan, problem.goal is not None, seed, tick)
    finally:
        environment.close()
    manifest = {
        **{name: value for name, value in learnt.manifest.items() if name not in ("returns", "outcomes")},
        "consolidated_from": digest(file),
        "command": command or learnt.manifest.get("command", ""),
        **found.figures,
    }
    return LatentPolicy(found.controller, learnt.dt, learnt.wiring, manifest), found.figures


def load_latent(file: Path) -> LatentPolicy:
    """Return a learnt policy.

    Raises:
        KoopmanError: the file cannot be read, or its policy is of another kind.
    """
    policy = load_policy(file)
    if not isinstance(policy, LatentPolicy):
        raise KoopmanError(f"{file}: is a policy of fixed observables; this needs one that `learn` made")
    return policy


def collect(problem: Problem, results: Sequence[dict[str, Any]]) -> tuple[list[Result], dict[str, Any]]:
    """Return the table of all runs of a problem, one value a seed, and the curves as JSON."""
    ends = [result["consolidated"] for result in results]
    returns = [float(np.mean(end["learnt"]["returns"])) for end in ends]
    rows = [
        Result(_LEARNT, "return", "1", returns, problem.thesis),
        Result(_LEARNT, "actions to the best", "1", [float(result["best"]["actions"]) for result in results]),
        Result(_LEARNT, "time", "min", [sum(p["seconds"] for p in result["curve"]) / 60 for result in results]),
        Result(_LEARNT, "CPU time", "min", [sum(p["cpu_seconds"] for p in result["curve"]) / 60 for result in results]),
        Result(_CONSOLIDATED, "return", "1", [float(np.mean(end["returns"])) for end in ends]),
        Result(_CONSOLIDATED, "latent dimensions", "1", [float(end["latent"]) for end in ends]),
        Result(_CONSOLIDATED, "Riccati residual", "1", [end["dare_residual"] for end in ends]),
    ]
    for unit in ("episodes", "actions"):
        learnt = [result["interaction"] for result in results]
        rows += [
            Result(_LEARNT, f"{unit} for {what}", "1", [float(each[what][unit]) for each in learnt])
            for what in ("learning", "choosing")
        ]
        rows.append(Result(_CONSOLIDATED, f"{unit} more", "1", [float(end["interaction"][unit]) for end in ends]))
    for method, figures in ((_LEARNT, [end["learnt"] for end in ends]), (_CONSOLIDATED, ends)):
        rows.append(Result(method, "spectral radius of A - B K", "1", [each["spectral_radius"] for each in figures]))
        errors = [each["error_over_persistence"] for each in figures]
        rows.append(Result(method, "one-step error over persistence", "1", errors))
        if any(each["outcomes"] for each in figures):
            parts = [each["outcomes"].get("GOAL", 0) / max(1, sum(each["outcomes"].values())) for each in figures]
            rows.append(Result(method, "goal reached", "1", parts))
    curves = {
        name: [[point[name] for point in result["curve"]] for result in results]
        for name in ("steps", "averaged", "actor")
    }
    return rows, {"task": problem.name, "curves": curves}
