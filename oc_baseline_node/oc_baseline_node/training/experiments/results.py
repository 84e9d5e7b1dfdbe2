"""The results table of a task's runs with the thesis's values, and the data of the figures.

rows, figures = collect(oc_runs(load_navigation_task("car_navigation")), Path("runs/oc_training"))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_learning.study import collect_rows, curves_of, finished_runs, metric, metrics_of_speed

from ctrl_rl_core import Result
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
"""Values from thesis 3.3.3: Tables 3.4 and 3.6, Fig. 3.14 and 3.16."""


def collect(todo: Sequence[OcRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the table and the figure data of all finished runs.

    Returns:
        Table rows: for each method, one value per seed from the last evaluation: success, trap rate (if there is a
            trap), mean undiscounted return; and the samples to reach `GOOD` (seeds that never do are omitted and
            counted). Figure data: `curves`, `advantages` (see `BaselineBuffer.ranges`) and `paths` by method.
    """
    task = todo[0].task
    found = finished_runs(todo, folder, lambda run: run.method_name)
    metrics = [
        metric("success", "1", lambda result: result["success"]),
        *([metric("trap rate", "1", lambda result: _rate(result, "TRAP"))] if task.trap is not None else []),
        metric("collision rate", "1", lambda result: _rate(result, "COLLISION")),
        metric("return", "1", lambda result: float(np.mean(result["returns"]))),
        *metrics_of_speed(),
    ]
    rows = collect_rows(found, metrics, lambda run, name: THESIS.get((task.name, run.method_name, name)))
    figures = {
        "curves": curves_of(found, success="evaluation", total="return"),
        "advantages": {
            name: [[point["notes"]["advantages"] for point in result["curve"]] for _, result in runs]
            for name, runs in found.items()
        },
        "paths": {name: runs[0][1]["paths"] for name, runs in found.items()},
    }
    return rows, figures


LABELS = {name: method.label for name, method in METHODS.items()}
"""Labels of the methods in the table."""


def _rate(result: Mapping[str, Any], outcome: str) -> float:
    return float(result["ended"][outcome] / sum(result["ended"].values()))
