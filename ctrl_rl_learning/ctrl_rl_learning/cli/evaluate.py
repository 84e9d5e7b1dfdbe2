"""The command `evaluate`: success and return of a learnt policy in new episodes, with confidence intervals."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from ctrl_rl_core.command import NotNegative, OptionalFileToWrite, Positive
from ctrl_rl_core.tasks import require

from ctrl_rl_core import Result, task_digest, write_results
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.study.command import find_learnt_task, make_command

_CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Run new episodes with a learnt policy, and report success and return with their 95 % intervals."""

    policy: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Policy file that `train` wrote."""
    task: str | None = None
    """Task of the suite, or a task file (default: the task that the policy was trained on)."""
    episodes: Positive = 100
    """Number of episodes."""
    seed: NotNegative = 0
    """Seed of the first episode; later episodes count up from it."""
    results: OptionalFileToWrite = None
    """JSON file to write the success and return of each episode to."""


def success_interval(succeeded: Sequence[bool]) -> tuple[float, float]:
    """Return the 95 % confidence interval of the success rate (Wilson)."""
    from scipy.stats import binomtest

    found = binomtest(sum(succeeded), len(succeeded)).proportion_ci(_CONFIDENCE, method="wilson")
    return float(found.low), float(found.high)


def mean_interval(totals: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean (Student's t); NaN for a single episode."""
    from scipy.stats import t

    if len(totals) < 2:
        return float("nan"), float("nan")
    half = float(t.ppf(0.5 + 0.5 * _CONFIDENCE, len(totals) - 1) * np.std(totals, ddof=1) / np.sqrt(len(totals)))
    return float(np.mean(totals)) - half, float(np.mean(totals)) + half


def report(options: EvaluateOptions, task: str, succeeded: Sequence[bool] | None, totals: Sequence[float]) -> int:
    """Print the results of the episodes, write them if requested, and return the exit code.

    Args:
        options: Options of the command.
        task: Name of the task.
        succeeded: Whether each episode reached its goal; None where the task has none.
        totals: Undiscounted return of each episode.
    """
    name, rows, intervals = options.policy.name, [Result(options.policy.name, "return", "1", totals)], {}
    print(f"episodes   {len(totals)} of {task}, from seed {options.seed}")
    if succeeded is not None:
        low, high = intervals["success"] = success_interval(succeeded)
        rows.insert(0, Result(name, "success", "1", [float(each) for each in succeeded]))
        print(f"success    {np.mean(succeeded):.1%} (95 %: {low:.1%} to {high:.1%})")
    low, high = intervals["return"] = mean_interval(totals)
    print(f"return     {np.mean(totals):.4g} (95 %: {low:.4g} to {high:.4g})")
    if options.results is not None:
        seeds = range(options.seed, options.seed + len(totals))
        write_results(options.results, f"evaluate_{task}", seeds, rows, {"task": task, "intervals": intervals})
        print(f"results    {options.results}")
    return 0


def _evaluate_actor(options: EvaluateOptions) -> int:
    from ctrl_rl_core import Actor
    from ctrl_rl_learning.sb3.environment import DEPLOYED_RATE, SUCCESS, evaluate, make_environment, observation_names

    actor = Actor.load(options.policy)
    task = find_learnt_task(options.policy, str(actor.manifest.get("task")), options.task, LearningError)
    require("ttr_reward_node evaluate", task)
    for what, ours, sizes, theirs in (
        ("observations", actor.manifest.get("observation"), actor.middle, observation_names(task)),
        ("commands", actor.manifest.get("commands"), actor.low, list(task.robot.commands)),
    ):
        if ours != theirs or len(sizes) != len(theirs):
            raise LearningError(f"{options.policy}: its {what} are not those of task '{task.name}': give one that fits")
    if actor.manifest.get("task_digest") != task_digest(task):
        print(f"evaluate: {options.policy}: was trained on another task or another version of it", file=sys.stderr)
    environment: Any = make_environment(task, DEPLOYED_RATE)
    try:
        episodes = evaluate(actor, environment, options.episodes, options.seed)
    finally:
        environment.close()
    succeeded = [episode.outcome == SUCCESS for episode in episodes]
    return report(options, task.name, succeeded, [episode.total for episode in episodes])


evaluate = make_command("evaluate", EvaluateOptions, _evaluate_actor)
