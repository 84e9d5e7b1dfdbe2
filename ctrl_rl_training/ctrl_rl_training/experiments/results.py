"""What finished runs amount to: tables, curves and paths, as JSON, from which pictures are drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from ctrl_rl_core.io.checked_json import read_json
from ctrl_rl_core.io.file_checks import FileError, raise_as
from ctrl_rl_core.io.results import Result, ResultsError

from ctrl_rl_training.experiments.figure_data import Figures
from ctrl_rl_training.experiments.run import Run
from ctrl_rl_training.experiments.run_folder import read_result, result_file

AnyRun = TypeVar("AnyRun", bound=Run)
GOOD = 0.9
"""Success that counts as learnt (thesis 3.2.3)."""


def finished_runs(
    todo: Sequence[AnyRun], folder: Path, label: Callable[[AnyRun], str]
) -> dict[str, list[tuple[AnyRun, dict[str, Any]]]]:
    """Return the runs that are finished and their results (see `trainer.train`), by method."""
    runs: dict[str, list[tuple[AnyRun, dict[str, Any]]]] = {}
    for run in todo:
        file = result_file(folder, run)
        if file.is_file():
            runs.setdefault(label(run), []).append((run, read_result(file)))
    return runs


def samples_to(curve: Sequence[Mapping[str, Any]], key: str = "evaluation", least: float = GOOD) -> float | None:
    """Return after how many samples what `key` names first was enough and the next was too; None if it never was."""
    good = [point[key] >= least for point in curve]
    for index, point in enumerate(curve):
        if good[index] and (index + 1 == len(curve) or good[index + 1]):
            return float(point["samples"])
    return None


def curves(results: Sequence[Mapping[str, Any]], **names: str) -> dict[str, list[Any]]:
    """Return `samples` (iterations,) and, for each keyword, what the curves call by its value (seeds, iterations)."""
    length = min(len(result["curve"]) for result in results)
    out: dict[str, list[Any]] = {"samples": [point["samples"] for point in results[0]["curve"][:length]]}
    for name, key in names.items():
        out[name] = [[point[key] for point in result["curve"][:length]] for result in results]
    return out


def as_table(rows: Sequence[Result], labels: Mapping[str, str]) -> str:
    """Return rows as text: mean and standard deviation over the seeds, and the thesis's figure.

    Args:
        rows: of results.
        labels: of methods, for those whose own name does not say enough.
    """
    head = ("method", "metric", "ours", "thesis")
    lines = [head, *(_cells(row, labels.get(row.method, row.method)) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        f"{method:<{widths[0]}}   {metric:<{widths[1]}}   {ours:>{widths[2]}}   {thesis}".rstrip()
        for method, metric, ours, thesis in lines
    )


def _cells(row: Result, label: str) -> tuple[str, str, str, str]:
    ours = f"{np.mean(row.values):.4g} ± {np.std(row.values):.2g}"
    return label, row.metric, ours, "" if row.thesis is None else f"{row.thesis:g}"


def read_figures(file: Path, kind: type[Figures]) -> dict[str, Any]:
    """Return the figures' data of a results file.

    Args:
        file: that `train --results` wrote.
        kind: what they must be.

    Raises:
        ResultsError: there is no such file, or it holds something else.
    """
    other = "is not a file that `train --results` wrote"
    with raise_as(ResultsError, file):
        content = read_json(file)
        figures = content.get("figures") if isinstance(content, dict) else None
        if not isinstance(figures, dict):
            raise FileError(f"{other}: give one of those")
        lacking = [name for name, field in kind.model_fields.items() if field.is_required() and name not in figures]
        if lacking:
            advice = "give one that `train` of the same package wrote"
            raise FileError(f"{other}, it lacks {', '.join(lacking)}: {advice}")
        return kind.model_validate(figures).model_dump(exclude_unset=True)
