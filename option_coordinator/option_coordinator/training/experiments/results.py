"""The results table of a task's runs with the thesis's values, and curves to draw.

rows, figures = collect(option_runs("tool_delivery", ["async"], 10), Path("runs/options"))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ctrl_rl_learning.study import Metric, collect_rows, curves_of, finished_runs, metric, metrics_of_speed

from ctrl_rl_core import Result
from option_coordinator.environments.roll_out import play_episodes
from option_coordinator.environments.tasks import make_environment
from option_coordinator.scripted.task_policies import references
from option_coordinator.training.experiments.evaluation import DRAWS, MODE, fresh, summary
from option_coordinator.training.experiments.methods import METHODS
from option_coordinator.training.experiments.runs import OptionRun

METRICS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "tool_delivery": {
        "return": ("return", "1"),
        "steps": ("makespan", "s"),
        "deliveries": ("deliveries", "1"),
        "option_reward": ("reward of an option step", "1"),
        "last_reward": ("last reward of an option step (thesis)", "1"),
    },
    "water_filling": {
        "mean_reward": ("reward of a low-level step", "1"),
        "fills": ("fills", "1"),
        "option_reward": ("reward of an option step", "1"),
        "last_reward": ("last reward of an option step (thesis)", "1"),
    },
    "team_delivery": {
        "return": ("return", "1"),
        "makespan": ("makespan", "s"),
        "deliveries": ("deliveries", "1"),
    },
}
"""Names and units of metrics, by summary key; low-level steps of Tool Delivery last one second."""
MAIN = {"tool_delivery": "return", "water_filling": "mean_reward", "team_delivery": "return"}
"""Main metric of learning."""
ENOUGH = {"tool_delivery": 230.0}
"""Threshold of the main metric that counts as learnt; by default the scripted policy's value."""
THESIS: Mapping[tuple[str, str, str], float] = {
    ("tool_delivery", "async", "last_reward"): 17.1,
    ("tool_delivery", "partial", "last_reward"): 4.4,
    ("tool_delivery", "mac_dqn_long", "last_reward"): 14.2,
    ("water_filling", "async", "last_reward"): -304.0,
    ("water_filling", "partial", "last_reward"): -349.0,
    ("water_filling", "mac_dqn_long", "last_reward"): -287.0,
}
"""Tables 5.2 and 5.3, which average only the last low-level reward of each option step."""
_EPISODES = 50
"""Number of episodes of policies that were not learnt."""


def collect(todo: Sequence[OptionRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the table and the figure data of all finished runs.

    Returns:
        Table rows: for each method, one value per seed for the policy as used in training; the main metric also for
            sampled and for most likely options; samples until `ENOUGH` is reached; and rows of policies that were not
            learnt. Figure data: `curves` by method, with `samples` (iterations,) and `values` (seeds, iterations) of
            the main metric during training.
    """
    task = todo[0].task
    names, main = METRICS[task.kind], MAIN[task.kind]
    title, unit = names[main]
    beside = reference_summaries(todo[0].task_name)
    scripted = beside["scripted"][main]
    enough = ENOUGH.get(task.kind, scripted)
    found = finished_runs(todo, folder, lambda run: run.method_name)
    for runs in found.values():
        for _, result in runs:
            for point in result["curve"]:
                point["main"] = point["learning"][main]
    metrics = [
        *(_metric(name, unit, None, key) for key, (name, unit) in names.items()),
        _metric(f"{title}, draws", unit, DRAWS, main),
        _metric(f"{title}, most likely options", unit, MODE, main),
        *metrics_of_speed("main", enough, f"{enough:.4g}", " in learning"),
    ]
    thesis = {(kind, method, METRICS[kind][key][0]): figure for (kind, method, key), figure in THESIS.items()}
    rows = collect_rows(found, metrics, lambda run, name: thesis.get((task.kind, run.method_name, name)))
    for name, summary_beside in beside.items():
        rows += [Result(name, title, unit, [summary_beside[key]]) for key, (title, unit) in names.items()]
    figures = {
        "task": task.name,
        "metric": title,
        "scripted": scripted,
        "curves": curves_of(found, values="main"),
    }
    return rows, figures


def _metric(name: str, unit: str, use: str | None, key: str) -> Metric:
    """Return a metric for one use of the policy; None for the use it was trained for."""
    return metric(name, unit, lambda result: result["final"][use or result["used"]][key])


def reference_summaries(task_name: str) -> dict[str, dict[str, float]]:
    """Return the `summary` of each reference policy."""
    environment = make_environment(task_name)
    choosers = references(environment).items()
    return {name: summary(list(play_episodes(environment, chooser, fresh(_EPISODES)))) for name, chooser in choosers}


LABELS = {name: method.label for name, method in METHODS.items()}
"""Labels of the methods in the table."""
