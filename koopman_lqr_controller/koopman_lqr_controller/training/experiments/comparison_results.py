"""What the runs of a comparison amount to: a table with the thesis's figures beside ours, and curves to draw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from ctrl_rl_core.io.results import Result

from koopman_lqr_controller.training.experiments.comparisons import COMPARISONS, LEVELS, REFERENCE
from koopman_lqr_controller.training.experiments.methods import METHODS

Results = Mapping[str, Sequence[Mapping[str, Any]]]
"""Results of `train`, one a seed, by the names of methods."""


def collect_comparison(name: str, task: str, results: Results) -> tuple[list[Result], dict[str, Any]]:
    """Return the rows of a comparison and the data of its picture.

    Args:
        name: One of `COMPARISONS`.
        task: Task that the runs learnt.
        results: Results of its methods.

    Returns:
        Rows, and `comparison`, `kind`, `task`, `reference` and, by method, `curves`: `samples`, steps of the system
        (chunks,), and `values`, returns in the evaluations (seeds, chunks); a run that ended early stays as it ended.
    """
    comparison = COMPARISONS[name]
    if comparison.kind == "levels":
        rows = [row for method in results for row in _levels(method, comparison.levels, results[method])]
    else:
        rows = []
    for method in results:
        rows += _finals(METHODS[method].label, results[method], *comparison.thesis.get((task, method), (None, None)))
    figures = {
        "comparison": name,
        "kind": comparison.kind,
        "task": task,
        "reference": REFERENCE.get(task),
        "curves": {method: _curves(each) for method, each in results.items()},
    }
    return rows, figures


def _finals(
    label: str, results: Sequence[Mapping[str, Any]], thesis_return: float | None, thesis_error: float | None
) -> list[Result]:
    """Return what the best policies do in fresh episodes, and what it took."""
    rows = [Result(label, "return", "1", [float(np.mean(each["returns"])) for each in results], thesis_return)]
    if all("model_error" in each for each in results):
        rows.append(Result(label, "model error", "1", [each["model_error"] for each in results], thesis_error))
        errors = [each["error_over_persistence"] for each in results]
        rows.append(Result(label, "one-step error over persistence", "1", errors))
    rows.append(Result(label, "actions to the best", "1", [float(each["best"]["actions"]) for each in results]))
    rows.append(Result(label, "CPU time", "min", [each["cpu_seconds"] / 60 for each in results]))
    return rows


def _levels(method: str, levels: Sequence[float], results: Sequence[Mapping[str, Any]]) -> list[Result]:
    """Return, for each level of the model's error, the best return in an evaluation of a run while it was there."""
    rows: list[Result] = []
    found: list[tuple[float, list[float]]] = []
    for level in levels:
        values = [best for result in results if (best := _best_at(level, result["curve"])) is not None]
        if values:
            found.append((level, values))
            row = Result(_at(method, level), "return at this model error", "1", values, LEVELS.get((method, level)))
            rows.append(row)
    for (before, better), (level, values) in pairwise(found):
        thesis = [LEVELS.get((method, each)) for each in (before, level)]
        lost = None if thesis[0] is None or thesis[1] is None else 100.0 * (1.0 - thesis[1] / thesis[0])
        ours = 100.0 * (1.0 - float(np.mean(values)) / float(np.mean(better))) if np.mean(better) else 0.0
        rows.append(Result(_at(method, level), "less than at the level before", "%", [ours], lost))
    return rows


def _at(method: str, level: float) -> str:
    return f"{METHODS[method].label}, model error ~{level:.0e}"


def _best_at(level: float, curve: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the best return of the candidates whose error has this order of magnitude; None where there is none."""
    returns = [
        point["returns"][name]
        for point in curve
        for name, error in point["model_errors"].items()
        if error > 0.0 and round(math.log10(error)) == round(math.log10(level))
    ]
    return max(returns, default=None)


def _curves(results: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    curves = [result["curve"] for result in results]
    longest = max(curves, key=len)
    values = [[next(iter(point["returns"].values())) for point in curve] for curve in curves]
    return {
        "samples": [point["steps"] for point in longest],
        "values": [each + [each[-1]] * (len(longest) - len(each)) for each in values],
    }
