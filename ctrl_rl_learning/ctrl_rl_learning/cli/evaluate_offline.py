"""The command `evaluate_offline`: predict from other drivers' bags how well a policy will do before it drives."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_core.command import OptionalFileToWrite, Positive, make_command

from ctrl_rl_core import Actor, Result, load_navigation_task, task_digest, write_results
from ctrl_rl_learning.cli.differences import refusing
from ctrl_rl_learning.cli.offline_steps import Reading, TaskOptions, judge, read_bags
from ctrl_rl_learning.cli.verdict_lines import estimate_lines, estimates_of, verdict_lines
from ctrl_rl_learning.errors import LearningError


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(TaskOptions):
    """Predict a policy's return from bags with 95 % intervals, and say whether it beats their driver.

    The verdict is better, not shown or worse, with advice on what to record next. Exits with 1 if the bags do not show
    that the policy is better than their driver, and with 2 if they show different walls from the task file.
    """

    policy: Path
    """Policy file that `learn_offline` or `train` wrote."""
    updates: Positive = 3000
    """Number of updates of each fit."""
    fits: Positive = 3
    """Number of fits; the intervals include their spread."""
    results: OptionalFileToWrite = None
    """JSON file to write the estimates to."""


def _evaluate(options: EvaluateOptions) -> int:
    task = load_navigation_task(options.task)
    actor = Actor.load(options.policy)
    if actor.manifest.get("task") not in (task.name, f"{task.name}_map" if options.map_from_bag else task.name):
        raise LearningError(f"{options.policy}: was trained on task '{actor.manifest.get('task')}', not '{task.name}'")
    from ctrl_rl_learning.offline.data.values import load_values
    from ctrl_rl_learning.offline.evaluation.roll_outs import can_model

    picture = (options.results or options.policy).with_suffix(".differences.png")
    reading = Reading(picture, None, options.value is not None or can_model(task))
    task, transitions = read_bags("evaluate_offline", task, options, reading)
    if actor.manifest.get("task_digest") != task_digest(task):
        print(f"evaluate_offline: {options.policy}: was trained on another version of the task", file=sys.stderr)
    values = None if options.value is None else load_values(options.value, task, options.values)
    report = judge(transitions, task, actor, values, updates=options.updates, fits=options.fits, seed=options.seed)
    print("\n".join(estimate_lines(report)))
    if options.results is not None:
        rows = [
            Result(options.policy.name, f"{name}{end}", "1", [getattr(estimate, key)])
            for name, estimate in estimates_of(report).items()
            for key, end in (("mean", ""), ("low", ", low"), ("high", ", high"))
        ]
        told = {"verdict": report.verdict, "better": report.better, "objections": dict(report.objections)}
        write_results(options.results, f"evaluate_offline_{task.name}", [options.seed], rows, told)
        print(f"results    {options.results}")
    for objection in report.objections:
        print(f"evaluate_offline: not called better: {objection.reason}", file=sys.stderr)
    print("\n".join(verdict_lines(report)))
    return 0 if report.better else 1


evaluate_offline = make_command("evaluate_offline", EvaluateOptions, refusing("evaluate_offline", _evaluate))
