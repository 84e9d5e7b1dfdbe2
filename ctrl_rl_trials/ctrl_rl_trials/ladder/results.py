"""Table of the ladder's runs and the data of their figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ctrl_rl_core.io import add_results, results_lock
from ctrl_rl_learning.study import (
    Figures,
    SuccessCurve,
    collect_rows,
    curves_of,
    finished_runs,
    metric,
    metrics_of_speed,
    read_figures,
)
from pydantic import Field

from ctrl_rl_core import Result
from ctrl_rl_trials.ladder.runs import LadderRun


class LadderFigures(Figures):
    """Figure data of the ladder, see `collect`."""

    curves: Annotated[dict[str, SuccessCurve], Field(min_length=1, max_length=2000)]


def collect(todo: Sequence[LadderRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows and the curves of all finished runs.

    Returns:
        For each task, way and learner `success` (in PyBullet), one value per seed, and `samples to 90 %` (in the
        training engine; seeds that never reach 90 % are omitted and counted); and the success curves by method.
    """
    found = finished_runs(todo, folder, lambda run: run.method)
    metrics = [metric("success", "1", lambda result: result["success"]), *metrics_of_speed(words="90 %")]
    return collect_rows(found, metrics), curves_of(found, success="evaluation")


def read_curves(path: Path) -> dict[str, Any]:
    """Return the success curves by method of a results file; empty if there is no file.

    Raises:
        ResultsError: The file cannot be read, or is not the ladder's.
    """
    return dict(read_figures(path, LadderFigures)["curves"]) if path.exists() else {}


def write(path: Path, seeds: int, rows: Sequence[Result], curves: Mapping[str, Any]) -> None:
    """Write rows and curves, and keep the file's data of other methods.

    Raises:
        ResultsError: The existing file cannot be read, or is not the ladder's.
    """
    with results_lock(path):
        figures = {"task": "ladder", "curves": {**read_curves(path), **curves}}
        add_results(path, "ladder", range(seeds), rows, figures)


def as_table(rows: Sequence[Result]) -> str:
    """Return the success rates as text, with a line for each task and learner and a column for each way."""
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
