"""The command `evaluate_offline`: what bags of other drivers say about a policy before it drives."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ctrl_rl_bags.datasets import print_note
from ctrl_rl_core.command import OptionalFileToWrite, Positive, make_command
from tqdm import tqdm

from ctrl_rl_core import Actor, Result, load_navigation_task, task_digest, write_results
from ctrl_rl_learning.cli.offline_steps import TaskOptions
from ctrl_rl_learning.errors import LearningError

if TYPE_CHECKING:
    from ctrl_rl_learning.offline.evaluation.verdict import OfflineReport
    from ctrl_rl_learning.study.results import Estimate


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(TaskOptions):
    """Predict from bags what a policy would earn, with 95 % intervals: better, not shown or worse, and what to record.

    Exits with 1 where the bags do not show that the policy is better than their driver.
    """

    policy: Path
    """Policy file that `learn_offline` or `train` wrote."""
    updates: Positive = 3000
    """Number of updates of each fit."""
    fits: Positive = 3
    """Number of fits, whose spread is part of the intervals."""
    results: OptionalFileToWrite = None
    """JSON file to write the estimates to."""


def _evaluate(options: EvaluateOptions) -> int:
    task = load_navigation_task(options.task)
    actor = Actor.load(options.policy)
    if actor.manifest.get("task") != task.name:
        raise LearningError(f"{options.policy}: has learnt the task '{actor.manifest.get('task')}', not '{task.name}'")
    if actor.manifest.get("task_digest") != task_digest(task):
        print(f"evaluate_offline: {options.policy}: has learnt another version of the task", file=sys.stderr)
    from ctrl_rl_learning.offline.data.transitions import load_transitions
    from ctrl_rl_learning.offline.data.values import load_values
    from ctrl_rl_learning.offline.evaluation.report import evaluate_offline as judge

    values = None if options.value is None else load_values(options.value, task, options.values)
    transitions = load_transitions(options.runs, task, options, tell=partial(print_note, "evaluate_offline"))
    with tqdm(total=options.fits * options.updates, desc="evaluating", unit="update", disable=None) as bar:
        report = judge(
            transitions,
            task,
            actor,
            values,
            updates=options.updates,
            fits=options.fits,
            seed=options.seed,
            tell=bar.update,
        )
    _print(report)
    if options.results is not None:
        rows = [
            Result(options.policy.name, f"{name}{end}", "1", [getattr(estimate, key)])
            for name, estimate in _estimates(report).items()
            for key, end in (("mean", ""), ("low", ", low"), ("high", ", high"))
        ]
        told = {"verdict": report.verdict, "better": report.better, "objections": dict(report.objections)}
        write_results(options.results, f"evaluate_offline_{task.name}", [options.seed], rows, told)
        print(f"results    {options.results}")
    for objection in report.objections:
        print(f"evaluate_offline: not called better: {objection.reason}", file=sys.stderr)
    print(f"verdict    {_WORDS[report.verdict]}, success {report.success.mean:.0%} beside {report.driver_success:.0%}")
    for drives in dict.fromkeys(objection.record for objection in report.objections):
        print(f"record     {drives}")
    return 0 if report.better else 1


_WORDS = {
    "better": "better than the driver of the bags",
    "not shown": "not shown to be better than the driver of the bags",
    "worse": "worse than the driver of the bags",
}


def _estimates(report: OfflineReport) -> dict[str, Estimate]:
    """Return the estimates that there are, by their names in the table."""
    estimates = {
        "driver of the bags": report.driver,
        "fitted Q evaluation": report.fitted_q,
        "doubly robust": report.doubly_robust,
        "roll-outs in the model": report.model,
        "gain, fitted Q": report.gain,
        "gain, doubly robust": report.robust_gain,
        "gain, roll-outs": report.model_gain,
        "success, policy": report.success,
        "success, gain": report.success_gain,
        "time lost, policy": report.time_lost,
        "time lost, driver": report.driver_time_lost,
        "time to goal, value": report.predicted_time,
        "time to goal, bags": report.recorded_time,
    }
    return {name: estimate for name, estimate in estimates.items() if estimate is not None}


def _print(report: OfflineReport) -> None:
    """Print the estimates and what they rest on."""
    print(f"{'discounted return':<22} mean       95 % interval")
    for name, estimate in _estimates(report).items():
        print(f"{name:<22} {estimate}")
    seen = "does not say" if report.held_out is None else f"{report.held_out} of {report.episodes}"
    print(f"held out   episodes that the policy was not fitted to: {seen}")
    all_of = f"of {report.episodes} episodes"
    print(
        f"fitted Q   rests on {report.effective_episodes:.1f} {all_of}; the driver would have given "
        f"{report.coverage:.0%} of the policy's commands"
    )
    support = report.support
    if support is not None:
        print(
            f"roll-outs  rest on {support.effective:.1f} {all_of}; {support.outside:.0%} of the steps lie where nobody "
            f"drove, {support.beyond:.0%} are beyond the recorded commands\n"
            f"           the model replays the bags with a correlation of {support.agreement:.2f}, and misses the ends "
            f"of {support.pieces} pieces like the policy's by {support.missed:.0%}\n"
            f"           {support.scans_off:.1%} of the ranges are not those of the walls; the models differ by "
            f"{support.disagreement:.0f}"
        )
    print(f"go by      {'roll-outs in the model' if report.by_model else 'fitted Q evaluation'}")


evaluate_offline = make_command("evaluate_offline", EvaluateOptions, _evaluate)
