"""What the runs of a task amount to: one table with the thesis's figures beside ours, and curves to draw.

rows, figures = collect(option_runs("tool_delivery", ["async"], 10), Path("runs/options"))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.results import Result
from ctrl_rl_training.results import finished_runs

from option_coordinator.roll_out import play_episodes
from option_coordinator.scripted import scripted_chooser
from option_coordinator.tasks import make_environment
from option_coordinator.training.methods import METHODS
from option_coordinator.training.runs import OptionRun, summary

METRICS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "tool_delivery": {
        "return": ("return", "1"),
        "steps": ("makespan", "s"),
        "deliveries": ("deliveries", "1"),
        "option_reward": ("reward of an option step (thesis)", "1"),
    },
    "water_filling": {
        "mean_reward": ("reward of a low-level step", "1"),
        "fills": ("fills", "1"),
        "option_reward": ("reward of an option step (thesis)", "1"),
    },
}
"""Metrics by what a summary calls them: name and unit; low-level steps of Tool Delivery last a second."""
MAIN = {"tool_delivery": "return", "water_filling": "mean_reward"}
"""What learning is judged by."""
THESIS: Mapping[tuple[str, str, str], float] = {
    ("tool_delivery", "async", "option_reward"): 17.1,
    ("tool_delivery", "partial", "option_reward"): 4.4,
    ("tool_delivery", "mac_dqn", "option_reward"): 14.2,
    ("water_filling", "async", "option_reward"): -304.0,
    ("water_filling", "partial", "option_reward"): -349.0,
    ("water_filling", "mac_dqn", "option_reward"): -287.0,
}
"""Tables 5.2 and 5.3; Mac-DQN's after 400K (Tool Delivery) and 600K (Water Filling) samples."""
_SCRIPTED = "scripted"
_SCRIPTED_EPISODES = 20


def collect(todo: Sequence[OptionRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the table and the figures' data of all runs that are finished.

    Returns:
        For each method, one value a seed, of the last evaluation, and a row of the scripted policy. And `curves` by
        method: `samples` (iterations,), `values` (seeds, iterations) of the evaluations by the main metric.
    """
    task = todo[0].task
    metrics, main = METRICS[task.kind], MAIN[task.kind]
    found = finished_runs(todo, folder, lambda run: run.method_name)
    rows: list[Result] = []
    for name, runs in found.items():
        for key, (metric, unit) in metrics.items():
            values = [float(result["final"][key]) for _, result in runs]
            rows.append(Result(name, metric, unit, values, THESIS.get((task.kind, name, key))))
    scripted = scripted_summary(todo[0].task_name)
    rows += [Result(_SCRIPTED, metric, unit, [scripted[key]]) for key, (metric, unit) in metrics.items()]
    figures = {
        "task": task.name,
        "metric": metrics[main][0],
        "scripted": scripted[main],
        "curves": {name: _curve([result for _, result in runs], main) for name, runs in found.items()},
    }
    return rows, figures


def scripted_summary(task_name: str) -> dict[str, float]:
    """Return what the hand-written policy reaches, see `summary`."""
    environment = make_environment(task_name)
    return summary(list(play_episodes(environment, scripted_chooser(environment), range(_SCRIPTED_EPISODES))))


def as_table(rows: Sequence[Result]) -> str:
    """Return the rows as text: mean and standard deviation over the seeds, and the thesis's figure."""
    lines = [f"{'method':<32} {'metric':<34} {'ours':>20}   thesis"]
    for row in rows:
        ours = f"{np.mean(row.values):.4g} ± {np.std(row.values):.2g}"
        thesis = "" if row.thesis is None else f"{row.thesis:g}"
        label = METHODS[row.method].label if row.method in METHODS else row.method
        lines.append(f"{label:<32} {row.metric:<34} {ours:>20}   {thesis}")
    return "\n".join(lines)


def _curve(results: Sequence[Mapping[str, Any]], key: str) -> dict[str, Any]:
    return {
        "samples": [point["samples"] for point in results[0]["curve"]],
        "values": [[point["evaluation"][key] for point in result["curve"]] for result in results],
    }
