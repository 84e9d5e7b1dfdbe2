"""Tables of finished runs by declared metrics, schemas of curves and figure data, and bootstrap estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from ctrl_rl_core.io import FileError, Name, Schema, raise_as, read_json, spread_of
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from ctrl_rl_core import Result, ResultsError
from ctrl_rl_learning.study.run import Run, read_result, result_file

Series = Annotated[list[float], Field(min_length=1, max_length=100_000)]
Seeds = Annotated[list[Series], Field(min_length=1, max_length=10_000)]
"""For each seed, one value per iteration."""
State = Annotated[list[float], Field(min_length=2, max_length=50)]


class _Data(Schema):
    """Schema whose numbers may be NaN, for quantities without a measurement."""

    model_config = ConfigDict(allow_inf_nan=True)


class Curve(_Data):
    """Figures of a method's seeds by number of samples."""

    samples: Series

    @model_validator(mode="after")
    def _as_long_as_each_other(self) -> Curve:
        for name, seeds in self:
            if name != "samples" and any(len(values) != len(self.samples) for values in seeds):
                raise ValueError(f"{name}: needs one value for each entry of samples")
        return self


class ValueCurve(Curve):
    """Curve of one figure."""

    values: Seeds


class SuccessCurve(Curve):
    """Curve of the success rate."""

    success: Seeds


class ReturnCurve(SuccessCurve):
    """Curve of success rate and return."""

    total: Seeds


class DrivenPath(_Data):
    """States and outcome of an episode."""

    outcome: Name
    states: Annotated[list[State], Field(min_length=1, max_length=1_000_000)]

    @model_validator(mode="after")
    def _of_one_size(self) -> DrivenPath:
        if len({len(state) for state in self.states}) > 1:
            raise ValueError("states: must all have the same size")
        return self


class Figures(_Data):
    """Figure data in a results file; each package adds its own fields."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    task: Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$", max_length=100)]
    task_digest: str | None = None


Array = NDArray[np.float64]
_RESAMPLED = 1000


@dataclass(frozen=True)
class Estimate:
    """Mean and 95 % bootstrap interval over episodes and fits."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:9.3f}  ({self.low:.3f} to {self.high:.3f})"


def estimate(numbers: Array, random: np.random.Generator) -> Estimate:
    """Return mean and bootstrap interval of numbers (fits, episodes), resampling episodes and drawing one fit each."""
    fits, count = numbers.shape
    drawn = random.integers(count, size=(_RESAMPLED, count))
    means = numbers[random.integers(fits, size=_RESAMPLED)[:, None], drawn].mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return Estimate(float(numbers.mean()), float(low), float(high))


AnyRun = TypeVar("AnyRun", bound=Run)
Finished = dict[str, list[tuple[AnyRun, dict[str, Any]]]]
"""Runs and their results by method."""
GOOD = 0.9
"""Success rate that counts as learnt (thesis 3.2.3)."""


def finished_runs(runs: Sequence[AnyRun], folder: Path, label: Callable[[AnyRun], str]) -> Finished[AnyRun]:
    """Return the finished runs with their results (see `trainer.train`), by method."""
    out: Finished[AnyRun] = {}
    for run in runs:
        file = result_file(folder, run)
        if file.is_file():
            out.setdefault(label(run), []).append((run, read_result(file)))
    return out


def samples_to(curve: Sequence[Mapping[str, Any]], key: str = "evaluation", least: float = GOOD) -> float | None:
    """Return the samples after which `key` first reaches `least` and keeps it at the next point; None if never."""
    good = [point[key] >= least for point in curve]
    for index, point in enumerate(curve):
        if good[index] and (index + 1 == len(curve) or good[index + 1]):
            return float(point["samples"])
    return None


@dataclass(frozen=True)
class Metric:
    """Column of a table.

    Attributes:
        name: Name of the metric.
        unit: Unit of the metric, "1" for none.
        values: Returns the values for the results of a method's seeds, usually one per seed.
    """

    name: str
    unit: str
    values: Callable[[Sequence[Mapping[str, Any]]], list[float]]


def metric(name: str, unit: str, value: Callable[[Mapping[str, Any]], float]) -> Metric:
    """Return a metric with one value per seed."""
    return Metric(name, unit, lambda results: [float(value(result)) for result in results])


def metrics_of_speed(
    key: str = "evaluation", least: float = GOOD, words: str = f"{GOOD:.0%}", more: str = ""
) -> list[Metric]:
    """Return two metrics: how many seeds reach a level, and after how many samples (see `samples_to`).

    Args:
        key: Name of the figure in the curve.
        least: Level to reach.
        words: Text of the level in the metrics' names.
        more: Suffix of the first metric's name.
    """

    def reached(results: Sequence[Mapping[str, Any]]) -> list[float]:
        return [samples for each in results if (samples := samples_to(each["curve"], key, least)) is not None]

    return [
        Metric(f"seeds that reach {words}{more}", "1", lambda results: [float(len(reached(results)))]),
        Metric(f"samples to {words}", "1", reached),
    ]


def collect_rows(
    finished: Finished[AnyRun],
    metrics: Sequence[Metric],
    reference: Callable[[AnyRun, str], float | None] = lambda *_: None,
) -> list[Result]:
    """Return a row for each method and metric that has a value.

    Args:
        finished: Runs and results by method.
        metrics: Columns of the table.
        reference: Returns the thesis's figure for a run's method and a metric's name; None if the thesis gives none.
    """
    return [
        Result(method, metric.name, metric.unit, values, reference(runs[0][0], metric.name))
        for method, runs in finished.items()
        for metric in metrics
        if (values := metric.values([result for _, result in runs]))
    ]


def curves_of(finished: Finished[AnyRun], **names: str) -> dict[str, dict[str, list[Any]]]:
    """Return the `curves` of each method."""
    return {method: curves([result for _, result in runs], **names) for method, runs in finished.items()}


def curves(results: Sequence[Mapping[str, Any]], **names: str) -> dict[str, list[Any]]:
    """Return `samples` (iterations,) and, for each keyword NAME=KEY, figure KEY of the curves (seeds, iterations)."""
    length = min(len(result["curve"]) for result in results)
    out: dict[str, list[Any]] = {"samples": [point["samples"] for point in results[0]["curve"][:length]]}
    for name, key in names.items():
        out[name] = [[point[key] for point in result["curve"][:length]] for result in results]
    return out


def as_table(rows: Sequence[Result], labels: Mapping[str, str]) -> str:
    """Return rows as text: mean and sample standard deviation over the seeds, and the thesis's figure.

    Args:
        rows: Rows of the table.
        labels: Labels that replace method names.
    """
    head = ("method", "metric", "ours", "thesis")
    lines = [head, *(_cells(row, labels.get(row.method, row.method)) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        f"{method:<{widths[0]}}   {metric:<{widths[1]}}   {ours:>{widths[2]}}   {thesis}".rstrip()
        for method, metric, ours, thesis in lines
    )


def _cells(row: Result, label: str) -> tuple[str, str, str, str]:
    ours = f"{np.mean(row.values):.4g}{spread_of(row.values)}"
    return label, row.metric, ours, "" if row.thesis is None else f"{row.thesis:g}"


def read_figures(file: Path, kind: type[Figures]) -> dict[str, Any]:
    """Return the figure data in a results file.

    Args:
        file: Results file that `train --results` wrote.
        kind: Schema of the data.

    Raises:
        ResultsError: There is no such file, or it has other content.
    """
    other = "is not a file that `train --results` wrote"
    with raise_as(ResultsError, file):
        content = read_json(file)
        figures = content.get("figures") if isinstance(content, dict) else None
        if not isinstance(figures, dict):
            if isinstance(content, dict) and "rows" in content:
                raise FileError("holds a table without curves: there is nothing to draw")
            raise FileError(f"{other}: give one of those")
        lacking = [name for name, field in kind.model_fields.items() if field.is_required() and name not in figures]
        if lacking:
            advice = "give one that `train` of the same package wrote"
            raise FileError(f"{other}, it lacks {', '.join(lacking)}: {advice}")
        return kind.model_validate(figures).model_dump(exclude_unset=True)
