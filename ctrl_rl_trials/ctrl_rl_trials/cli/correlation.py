"""The command `correlation`: compare returns predicted from bags with the returns that policies then achieve."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ctrl_rl_core.command import FolderToWrite, OptionalFileToWrite, Positive, make_command
from ctrl_rl_core.io import as_lines
from ctrl_rl_core.tasks import require

from ctrl_rl_core import Result, load_navigation_task, write_results

_NAMES = {
    "recommended": "the estimate to go by",
    "model": "roll-outs in the model",
    "fitted_q": "fitted Q evaluation",
    "doubly_robust": "doubly robust",
    "time_lost": "value function",
}


@dataclass(frozen=True, kw_only=True)
class CorrelationOptions:
    """Train policies of varying quality, predict their returns from bags, and correlate with driven returns.

    There are eighteen policies; fewer for a task without an optimal control value. An interrupted call resumes;
    a folder of a call with other settings is refused.
    """

    task: str = "car_navigation"
    """Task of the suite, or a task file."""
    seeds: Positive = 5
    """Number of seeds, each with its own bags."""
    episodes: Positive = 150
    """Number of episodes in each seed's bag."""
    tests: Positive = 100
    """Number of test episodes per policy."""
    updates: Positive = 3000
    """Maximum number of updates of a policy and of a prediction; fewer than 3000 give a quick trial."""
    folder: FolderToWrite = Path("runs/offline_correlation")
    """Folder of bags, policies and predictions."""
    results: OptionalFileToWrite = None
    """JSON file for the correlations."""


def _correlation(options: CorrelationOptions) -> int:
    task = load_navigation_task(options.task)
    require("ctrl_rl_trials correlation", task)
    from ctrl_rl_trials.offline.correlation import CorrelationSettings, agreements, compare

    fit_updates = min(options.updates, CorrelationSettings.fit_updates)
    settings = CorrelationSettings(options.seeds, options.episodes, options.tests, options.updates, fit_updates)
    found = compare(task, options.folder, settings, print)
    rows = []
    agreed = agreements(found)
    for name in (name for name in _NAMES if name in agreed):
        method, agreement = f"{task.name}: {_NAMES[name]}", agreed[name]
        low, high = agreement.interval.tolist()
        rows.append(Result(method, "correlation", "1", agreement.correlation.tolist()))
        rows.append(Result(method, "correlation, low", "1", [low]))
        rows.append(Result(method, "correlation, high", "1", [high]))
        rows.append(Result(method, "rank correlation", "1", agreement.ranks.tolist()))
        rows.append(Result(method, "regret of the best", "1", agreement.regret.tolist()))
    drivers = np.array([[predicted[0]["driver"]] for predicted in found["predicted"]])
    gains = np.array([[each["return"] for each in found["driven"]]]) - drivers
    called = np.array([[each["better"] for each in seed] for seed in found["predicted"]], dtype=np.bool_)
    wrong = (called & (gains <= 0.0)).sum(axis=1) / np.maximum(called.sum(axis=1), 1)
    rows.append(Result(f"{task.name}: verdict", "called better", "1", called.mean(axis=1).tolist()))
    rows.append(Result(f"{task.name}: verdict", "wrongly called better", "1", wrong.tolist()))
    print(as_lines(rows))
    if options.results is not None:
        write_results(options.results, "offline_evaluation", range(options.seeds), rows, found)
        print(f"results    {options.results}")
    return 0


correlation = make_command("correlation", CorrelationOptions, _correlation)
