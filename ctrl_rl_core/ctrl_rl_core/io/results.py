"""Results as data: one JSON file per experiment, the source of tables and plots."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, model_validator

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io import checked_json
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.file_checks import raise_as
from ctrl_rl_core.io.folder_lock import folder_lock
from ctrl_rl_core.io.schema import Anything, Name, Schema


class ResultsError(CtrlRlError):
    """A results file cannot be read."""


Text = Annotated[str, Field(max_length=10_000)]


class _Written(Schema):
    """Part of a results file; a value may be NaN if there was nothing to measure."""

    model_config = ConfigDict(allow_inf_nan=True)


class Origin(_Written):
    """The command that measured a row, and the commit it ran on."""

    command: Text
    commit: Text


class Row(_Written):
    """One row as stored in a file."""

    method: Name
    metric: Name
    unit: Name
    values: Annotated[list[float], Field(min_length=1, max_length=1_000_000)]
    mean: float
    std: float | None
    thesis: float | None
    seeds: Annotated[list[int], Field(default_factory=list, max_length=1_000_000)]
    terms: Text = ""
    origins: Annotated[list[Origin], Field(default_factory=list, max_length=1_000)]

    @model_validator(mode="after")
    def _check_seeds(self) -> Row:
        """Check that there is one seed per value."""
        if self.terms and len(set(self.seeds)) != len(self.values):
            raise ValueError("seeds: must be one per value")
        return self

    @property
    def result(self) -> Result:
        """Return the row as a `Result`."""
        return Result(
            self.method,
            self.metric,
            self.unit,
            self.values,
            self.thesis,
            tuple(self.seeds),
            self.terms,
            tuple(self.origins),
        )


class Experiment(_Written):
    """Schema of a results file."""

    experiment: Name
    command: Text
    commit: Text
    seeds: Annotated[list[int], Field(max_length=100_000)]
    rows: Annotated[list[Row], Field(max_length=100_000)]
    figures: Anything | None = None


class Benchmark(_Written):
    """A row of `make bench`."""

    benchmark: Text = ""
    name: Name
    value: float
    unit: Name
    against: Text
    ratio: float | None


_BENCHMARKS = TypeAdapter(Annotated[list[Benchmark], Field(max_length=10_000)])


@dataclass(frozen=True)
class Result:
    """One row: a method's metric with one value per seed, and the thesis's value if there is one.

    Attributes:
        method: Name of the method.
        metric: Name of the metric.
        unit: Unit of the values, "1" for none.
        values: Values, one per seed.
        thesis: Value reported in the thesis.
        seeds: Seeds of the values, in order, if rows of one file have different seeds.
        terms: Digest of everything that determined the values except the seed; allows merging values of other seeds.
        origins: Commands that measured the values, if rows of one file come from different commands.
    """

    method: str
    metric: str
    unit: str
    values: Sequence[float]
    thesis: float | None = None
    seeds: tuple[int, ...] = ()
    terms: str = ""
    origins: tuple[Origin, ...] = ()

    def joined(self, other: Result) -> Result:
        """Return the row extended by another row's values for seeds that this row lacks, in seed order.

        A row with a different or missing digest in `terms` adds nothing.
        """
        if not self.terms or other.terms != self.terms or set(other.seeds) <= set(self.seeds):
            return self
        values = dict(zip((*other.seeds, *self.seeds), (*other.values, *self.values), strict=True))
        seeds = tuple(sorted(values))
        origins = tuple(dict.fromkeys((*other.origins, *self.origins)))
        return replace(self, seeds=seeds, values=[values[seed] for seed in seeds], origins=origins)


def write_results(
    path: Path,
    experiment: str,
    seeds: Sequence[int],
    rows: Sequence[Result],
    figures: Mapping[str, Any] | None = None,
) -> None:
    """Write an experiment's rows atomically, with the command and commit that produced them.

    Args:
        path: Path of the file, replaced if it exists.
        experiment: Name of the experiment.
        seeds: Seeds of the experiment.
        rows: Rows of the results table.
        figures: Plot data as JSON.
    """
    origin = _origin()
    content: dict[str, Any] = {
        "experiment": experiment,
        "command": origin.command,
        "commit": origin.commit,
        "seeds": list(seeds),
        "rows": [
            {
                "method": row.method,
                "metric": row.metric,
                "unit": row.unit,
                "values": list(row.values),
                "mean": float(np.mean(row.values)),
                "std": sample_deviation(row.values),
                "thesis": row.thesis,
                **({"seeds": list(row.seeds), "terms": row.terms} if row.terms else {}),
                **({"origins": [each.model_dump() for each in row.origins]} if row.origins else {}),
            }
            for row in rows
        ],
    }
    if figures is not None:
        content["figures"] = dict(figures)
    with results_lock(path):
        atomic_write(path, _dump(checked_json.with_digest(content)))


def add_results(
    path: Path,
    experiment: str,
    seeds: Sequence[int],
    rows: Sequence[Result],
    figures: Mapping[str, Any] | None = None,
    *,
    same_metric: bool = False,
) -> None:
    """Merge rows into a results file, safely against concurrent writers.

    Args:
        path: Path of the file; it need not exist.
        experiment: Name of the experiment.
        seeds: Seeds of the experiment.
        rows: New rows, see `with_others`.
        figures: Plot data as JSON.
        same_metric: See `with_others`.

    Raises:
        ResultsError: The existing file cannot be read.
    """
    with results_lock(path):
        write_results(path, experiment, seeds, with_others(path, rows, same_metric), figures)


@contextmanager
def results_lock(path: Path) -> Iterator[None]:
    """Lock a results file against other processes while it is read, changed and written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with folder_lock(path.parent):
        yield


def with_others(path: Path, rows: Sequence[Result], same_metric: bool = False) -> list[Result]:
    """Merge new rows into those of a results file; each row gets its origin.

    The file need not exist.

    Args:
        path: Path of the results file.
        rows: New rows; they replace all rows of their methods.
        same_metric: Whether to replace only rows with the same method and metric, keeping values of other seeds with
            the same `terms`.

    Raises:
        ResultsError: The file cannot be read.
    """

    def name(row: Row | Result) -> tuple[str, str]:
        return row.method, row.metric if same_metric else ""

    before = read_experiment(path) if path.exists() else None
    old = [row.result for row in before.rows] if before else []
    if before and not any(row.origins for row in old):  # the file's own command measured all of them
        old = [replace(row, origins=(Origin(command=before.command, commit=before.commit),)) for row in old]
    origin = _origin()
    new = [replace(row, origins=(origin,)) for row in rows]
    replaced = {name(row) for row in new}
    beside = {name(row): row for row in old} if same_metric else {}
    kept = [row for row in old if name(row) not in replaced]
    return [*kept, *(row.joined(beside.get(name(row), row)) for row in new)]


def as_lines(rows: Sequence[Result]) -> str:
    """Return each row's mean and sample standard deviation, one line per row."""
    methods, metrics = (max((len(getattr(row, name)) for row in rows), default=0) for name in ("method", "metric"))
    return "\n".join(
        f"{row.method:<{methods}}  {row.metric:<{metrics}} {np.mean(row.values):9.3f}{spread_of(row.values, '.3f')}"
        for row in rows
    )


def sample_deviation(values: Sequence[float]) -> float | None:
    """Return the sample standard deviation, with n - 1 in the denominator; None for a single value."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def spread_of(values: Sequence[float], form: str = ".2g") -> str:
    """Return " ± " and the sample standard deviation in a number format; empty for a single value."""
    deviation = sample_deviation(values)
    return "" if deviation is None else f" ± {deviation:{form}}"


def read_results(folder: Path) -> list[Experiment]:
    """Return all experiments of a folder; benchmark files are skipped.

    Raises:
        ResultsError: A file is damaged, or was not written by `write_results`.
    """
    found = [read_experiment(file) for file in sorted(folder.glob("*.json"))]
    return [each for each in found if each is not None]


def read_experiment(file: Path) -> Experiment | None:
    """Return the experiment of a file; None if it holds benchmark rows.

    Raises:
        ResultsError: The file is damaged, or was not written by `write_results`.
    """
    with raise_as(ResultsError, file):
        content = checked_json.read_json(file)
        return Experiment.model_validate(content) if isinstance(content, dict) and "rows" in content else None


def read_benchmarks(file: Path) -> list[Benchmark]:
    """Return the rows written by `make bench`; empty if it has not run.

    Raises:
        ResultsError: The file has other content.
    """
    if not file.exists():
        return []
    with raise_as(ResultsError, file):
        return _BENCHMARKS.validate_python(checked_json.read_json(file))


def _dump(content: Mapping[str, Any]) -> str:
    """Return the JSON text with one line per field and row; figures, which are long, take one line."""
    figures = content.get("figures")
    text = json.dumps({key: value for key, value in content.items() if key != "figures"}, indent=1)
    return f"{text}\n" if figures is None else f'{text[:-2]},\n "figures": {json.dumps(figures)}\n}}\n'


def _origin() -> Origin:
    """Return the running command and the commit of the working folder.

    Absolute paths are reduced to their last part, because their folders exist on one computer only.
    """
    name, *words = sys.argv
    kept = [Path(word).name if Path(word).is_absolute() else word for word in words]
    return Origin(command=" ".join([Path(name).name, *kept]), commit=_commit())


def _commit() -> str:
    """Return the commit of the working folder, or "" outside a repository."""
    try:
        answer = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return answer.stdout.strip()
