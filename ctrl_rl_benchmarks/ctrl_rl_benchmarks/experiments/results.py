"""The table of the ladder's runs, and the data of its figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_training.experiments.results import (
    collect_rows,
    curves_of,
    finished_runs,
    metric,
    metrics_of_speed,
)

from ctrl_rl_benchmarks.experiments.runs import LadderRun
from ctrl_rl_core import Result


def collect(todo: Sequence[LadderRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows and the curves of all runs that are finished.

    Returns:
        For each task, way and learner `success` (in PyBullet), one value a seed, and `samples to 90 %` (in the engine
        of learning; seeds that never get there are left out and counted); and the `curves` of success by method.
    """
    found = finished_runs(todo, folder, lambda run: run.method)
    metrics = [metric("success", "1", lambda result: result["success"]), *metrics_of_speed(words="90 %")]
    return collect_rows(found, metrics), {"curves": curves_of(found, success="evaluation")}


def as_table(rows: Sequence[Result]) -> str:
    """Return the success of the ways as text: a line for each task and learner, a column for each way."""
    success = {row.method: row.values for row in rows if row.metric == "success"}
    parts = [(*method.split(": ")[:1], *method.split(": ")[1].split(", ")) for method in success]
    ways = list(dict.fromkeys(way for _, way, _ in parts))
    lines = [f"{'success [%] (seeds)':<26}" + "".join(f"{way:>24}" for way in ways)]
    for task, learner in dict.fromkeys((task, learner) for task, _, learner in parts):
        cells = []
        for way in ways:
            values = success.get(f"{task}: {way}, {learner}")
            cells.append("-" if values is None else f"{100 * np.mean(values):.0f} ({len(values)})")
        lines.append(f"{task + ', ' + learner:<26}" + "".join(f"{cell:>24}" for cell in cells))
    return "\n".join(lines)
