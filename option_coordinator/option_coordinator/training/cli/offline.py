"""The command `evaluate_offline`: estimates a joint policy's return from bags of others before robots run it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from ctrl_rl_core.command import NotNegative, OptionalFileToWrite, Positive, make_command
from tqdm import tqdm

from ctrl_rl_core import Result, write_results
from option_coordinator.data.bag_trajectory import recordings
from option_coordinator.policies.policy_file import OptionPolicy, policy_file


@dataclass(frozen=True, kw_only=True)
class OfflineOptions:
    """Predict a joint policy's return from bags, with 95 % intervals, and tell whether it may be called better.

    Exits with 1 if the bags do not show that the policy is better than their deciders.
    """

    bags: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="BAG [BAG ...]")]
    """Bags with `joint_option_step`."""
    policy: str
    """Joint policy: a file, or the name of one that ships."""
    updates: Positive = 1500
    """Number of updates of each fit."""
    fits: Positive = 3
    """Number of fits; their spread is part of the intervals."""
    seed: NotNegative = 0
    """Seed of fits, draws and resampling."""
    results: OptionalFileToWrite = None
    """JSON file to write the estimates to."""


def _evaluate(options: OfflineOptions) -> int:
    policy = OptionPolicy.load(policy_file(options.policy))
    from option_coordinator.training.experiments.offline_evaluation import evaluate_offline as judge

    found = [recording for bag in options.bags for recording in recordings(bag)]
    with tqdm(total=options.fits * options.updates, desc="evaluating", unit="update", disable=None) as bar:
        report = judge(found, policy, updates=options.updates, fits=options.fits, seed=options.seed, tell=bar.update)
    estimates = {"deciders of the bags": report.driver, "fitted Q evaluation": report.policy, "gain": report.gain}
    print(f"{'discounted return':<22} mean       95 % interval, {report.episodes} episodes")
    for name, estimate in estimates.items():
        print(f"{name:<22} {estimate}")
    if options.results is not None:
        rows = [
            Result(Path(options.policy).name, f"{name}{end}", "1", [getattr(estimate, key)])
            for name, estimate in estimates.items()
            for key, end in (("mean", ""), ("low", ", low"), ("high", ", high"))
        ]
        write_results(options.results, "evaluate_offline_team", [options.seed], rows, {"better": report.better})
        print(f"results    {options.results}")
    if report.better:
        print("verdict    better than who decided in the bags")
        return 0
    print(
        f"evaluate_offline: not called better: the gain is {report.gain.low:.3f} to {report.gain.high:.3f}",
        file=sys.stderr,
    )
    return 1


evaluate_offline = make_command("evaluate_offline", OfflineOptions, _evaluate)
