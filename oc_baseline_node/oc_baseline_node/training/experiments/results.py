"""What the runs of a task amount to: one table with the thesis's figures beside ours, and what pictures are drawn from.

rows, figures = collect(oc_runs(load_navigation_task("car_navigation")), Path("runs/oc_training"))
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.io.results import Result
from ctrl_rl_training.experiments.results import GOOD, as_table, curves, finished_runs, samples_to

from oc_baseline_node.training.experiments.methods import METHODS
from oc_baseline_node.training.experiments.runs import OcRun

THESIS: dict[tuple[str, str, str], float] = {
    ("car_navigation", "oc_ppo", "success"): 1.0,
    ("car_navigation", "oc_ppo", "return"): 678.0,
    ("car_navigation", "entropy_0.01", "return"): -12.0,
    ("car_navigation", "entropy_0.02", "return"): -52.0,
    ("car_navigation", "entropy_0.05", "return"): -32.0,
    ("car_navigation", "entropy_0.1", "return"): -24.0,
    ("car_navigation", "noise_0.2", "return"): 200.0,
    ("quad_trap", "oc_ppo", "success"): 0.87,
    ("quad_trap", "oc_ppo", "trap rate"): 0.02,
    ("quad_trap", "oc_ppo", "return"): 929.0,
    ("quad_trap", "ppo", "success"): 0.13,
    ("quad_trap", "ppo", "trap rate"): 0.65,
    ("quad_trap", "entropy_0.01", "return"): 44.0,
    ("quad_trap", "entropy_0.02", "return"): 48.0,
    ("quad_trap", "entropy_0.05", "return"): 65.0,
    ("quad_trap", "entropy_0.1", "return"): 50.0,
}
"""Figures of 3.3.3: Tables 3.4 and 3.6, Fig. 3.14 and 3.16."""


def collect(todo: Sequence[OcRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the table and the figures' data of all runs that are finished.

    Returns:
        For each method, one value a seed, of the last evaluation: success, trap rate (where there is a trap), mean
        undiscounted return; and the samples to `GOOD` (seeds that never get there are left out and counted). And
        `curves`, `advantages` (see `BaselineBuffer.ranges`) and `paths` by method.
    """
    found = {
        name: (runs[0][0], [result for _, result in runs])
        for name, runs in finished_runs(todo, folder, lambda run: run.method_name).items()
    }
    rows: list[Result] = []
    for name, (run, results) in found.items():

        def add(metric: str, unit: str, values: list[float], name: str = name, run: OcRun = run) -> None:
            rows.append(Result(name, metric, unit, values, THESIS.get((run.task.name, name, metric))))

        add("success", "1", [result["success"] for result in results])
        if run.task.trap is not None:
            add("trap rate", "1", [_rate(result, "TRAP") for result in results])
        add("collision rate", "1", [_rate(result, "COLLISION") for result in results])
        add("return", "1", [float(np.mean(result["returns"])) for result in results])
        learnt = [samples for result in results if (samples := samples_to(result["curve"])) is not None]
        add(f"seeds that reach {GOOD:.0%}", "1", [float(len(learnt))])
        if learnt:
            add(f"samples to {GOOD:.0%}", "1", learnt)
    figures = {
        "curves": {name: curves(results, success="evaluation", total="return") for name, (_, results) in found.items()},
        "advantages": {
            name: [[point["notes"]["advantages"] for point in result["curve"]] for result in results]
            for name, (_, results) in found.items()
        },
        "paths": {name: results[0]["paths"] for name, (_, results) in found.items()},
    }
    return rows, figures


def table(rows: Sequence[Result]) -> str:
    """Return the rows as text."""
    return as_table(rows, {name: method.label for name, method in METHODS.items()})


def _rate(result: dict[str, Any], outcome: str) -> float:
    return float(result["ended"][outcome] / sum(result["ended"].values()))
