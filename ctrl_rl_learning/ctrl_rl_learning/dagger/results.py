"""The table of taught policies, and their curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ctrl_rl_core import Result
from ctrl_rl_learning.dagger.run import TaughtRun
from ctrl_rl_learning.study.results import as_table, collect_rows, curves_of, finished_runs, metric

_METRICS = (
    metric("success", "1", lambda result: float(result["success"])),
    metric("collisions", "1", lambda result: float(result["collisions"])),
    metric("processor time", "s", lambda result: float(result["cpu_seconds"])),
)


def collect(runs: Sequence[TaughtRun], folder: Path) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows of finished runs, each metric with one value a seed, and their `curves` of success."""
    found = finished_runs(runs, folder, lambda _: "taught by the time to reach")
    return collect_rows(found, _METRICS), {"curves": curves_of(found, success="evaluation")}


def as_text(rows: list[Result]) -> str:
    """Return the rows as text."""
    return as_table(rows, {})
