"""Results as data: one JSON file per experiment, from which tables and plots are made."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, model_validator

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io import checked_json
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.file_checks import raise_as
from ctrl_rl_core.io.schema import Anything, Name, Schema


class ResultsError(CtrlRlError):
    """A results file cannot be read."""


Text = Annotated[str, Field(max_length=10_000)]


class _Written(Schema):
    """Part of a file of ours; a figure may be NaN where there was nothing to measure."""

    model_config = ConfigDict(allow_inf_nan=True)


class Origin(_Written):
    """The command that measured a row, and the commit that it ran on."""

    command: Text
    commit: Text


class Row(_Written):
    """One row as it is written."""

    method: Name
    metric: Name
    unit: Name
    values: Annotated[list[float], Field(min_length=1, max_length=1_000_000)]
    mean: float
    std: float
    thesis: float | None
    seeds: Annotated[list[int], Field(default_factory=list, max_length=1_000_000)]
    terms: Text = ""
    origins: Annotated[list[Origin], Field(default_factory=list, max_length=1_000)]

    @model_validator(mode="after")
    def _check_seeds(self) -> Row:
        """Refuse seeds that are not one a value."""
        if self.terms and len(set(self.seeds)) != len(self.values):
            raise ValueError("seeds: must be one a value")
        return self

    @property
    def result(self) -> Result:
        """Return the row as it was given."""
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
    """A results file."""

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
    """One row: a method's figure, one value per seed, beside the thesis's where it has one.

    Attributes:
        method: Name of the method.
        metric: Name of the figure.
        unit: Its unit, "1" for none.
        values: Values, one a seed.
        thesis: The thesis's figure.
        seeds: Seeds of the values, in their order, where rows of one file have different ones.
        terms: Digest of all that made the values but the seed; with it, values of other seeds can join them.
        origins: Commands that measured the values, where rows of one file come from different ones.
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
        """Return the row with the values of another row's seeds that this one lacks, in the order of the seeds.

        A row that has other terms, or none, adds nothing.
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
    """Write an experiment's rows, with the command and commit that produced them; the file is written atomically.

    Args:
        path: Path of the file, which is replaced if it exists.
        experiment: Name of the experiment.
        seeds: That it ran with.
        rows: Rows of the results table.
        figures: Data of its plots, as JSON.
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
                "std": float(np.std(row.values)),
                "thesis": row.thesis,
                **({"seeds": list(row.seeds), "terms": row.terms} if row.terms else {}),
                **({"origins": [each.model_dump() for each in row.origins]} if row.origins else {}),
            }
            for row in rows
        ],
    }
    if figures is not None:
        content["figures"] = dict(figures)
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, _dump(checked_json.with_digest(content)))


def with_others(path: Path, rows: Sequence[Result], same_metric: bool = False) -> list[Result]:
    """Return rows after those of a results file that they do not replace, each with its origin.

    The file need not be there.

    Args:
        path: Path of the results file.
        rows: New rows; they replace all rows of their methods.
        same_metric: Whether they replace only rows with their method and metric, and values of other seeds that were
            made by the same terms stay in these.

    Raises:
        ResultsError: The file cannot be read.
    """

    def name(row: Row | Result) -> tuple[str, str]:
        return row.method, row.metric if same_metric else ""

    before = read_experiment(path) if path.exists() else None
    old = [row.result for row in before.rows] if before else []
    origin = _origin()
    new = [replace(row, origins=(origin,)) for row in rows]
    replaced = {name(row) for row in new}
    beside = {name(row): row for row in old} if same_metric else {}
    kept = [row for row in old if name(row) not in replaced]
    return [*kept, *(row.joined(beside.get(name(row), row)) for row in new)]


def as_lines(rows: Sequence[Result]) -> str:
    """Return each row's mean and standard deviation over its values, one a line."""
    methods, metrics = (max((len(getattr(row, name)) for row in rows), default=0) for name in ("method", "metric"))
    return "\n".join(
        f"{row.method:<{methods}}  {row.metric:<{metrics}} {np.mean(row.values):9.3f} +- {np.std(row.values):.3f}"
        for row in rows
    )


def read_results(folder: Path) -> list[Experiment]:
    """Return every experiment of a folder; benchmark rows, a list, are not one.

    Raises:
        ResultsError: A file is damaged, or was not written by `write_results`.
    """
    found = [read_experiment(file) for file in sorted(folder.glob("*.json"))]
    return [each for each in found if each is not None]


def read_experiment(file: Path) -> Experiment | None:
    """Return the experiment of a file; None where it holds benchmark rows.

    Raises:
        ResultsError: The file is damaged, or was not written by `write_results`.
    """
    with raise_as(ResultsError, file):
        content = checked_json.read_json(file)
        return Experiment.model_validate(content) if isinstance(content, dict) and "rows" in content else None


def read_benchmarks(file: Path) -> list[Benchmark]:
    """Return the rows that `make bench` wrote; none where it has not run.

    Raises:
        ResultsError: The file holds something else.
    """
    if not file.exists():
        return []
    with raise_as(ResultsError, file):
        return _BENCHMARKS.validate_python(checked_json.read_json(file))


def as_markdown(experiments: Sequence[Experiment], benchmarks: Sequence[Benchmark] = ()) -> str:
    """Return experiments and benchmarks as a page of tables, each figure beside the thesis's or a peer's."""
    lines = ["# Results", "", "Made from the JSON files in `docs/results/` by `make results`; do not edit."]
    for experiment in experiments:
        lines += ["", f"## {experiment.experiment}", "", *_head(experiment), "", *_table(experiment.rows)]
    if benchmarks:
        lines += ["", "## Benchmarks", "", "    make bench", "", "Each figure and its peer were measured in one run."]
        lines += ["", "| what | ours | against | ratio |", "|---|---|---|---|"]
        for row in benchmarks:
            ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
            lines.append(f"| {row.name} | {row.value:.4g} {row.unit} | {row.against} | {ratio} |")
    return "\n".join(lines) + "\n"


def _head(experiment: Experiment) -> list[str]:
    """Return the commands that measured an experiment's rows, and how its figures are written."""
    methods: dict[Origin, dict[str, None]] = {}
    for row in experiment.rows:
        for origin in row.origins:
            methods.setdefault(origin, {})[row.method] = None
    if not methods:
        return [f"    {experiment.command}", "", f"Commit {experiment.commit}{_notation(experiment)}."]
    lines: list[str] = []
    for origin, measured in methods.items():
        lines += [f"    {origin.command}", "", f"Commit {origin.commit}: {'; '.join(measured)}.", ""]
    older = "" if all(row.origins for row in experiment.rows) else "; the other rows are older"
    return [*lines, f"{len(experiment.rows)} rows{_notation(experiment)}{older}."]


def _notation(experiment: Experiment) -> str:
    """Return how many seeds stand behind the figures, and what is written beside a mean."""
    remark = ""
    if len(experiment.seeds) > 1:
        counts: dict[str, int] = {}
        for row in experiment.rows:
            counts[row.method] = max(counts.get(row.method, 0), len(row.values))
        most = max(counts.values(), default=0)
        up_to = "" if len(set(counts.values())) <= 1 else "up to "
        remark += f", {up_to}{most} seeds, mean and standard deviation over them"
    elif any(len(row.values) > 1 for row in experiment.rows):
        remark += ", mean and standard deviation"
    if any(row.thesis is not None for row in experiment.rows):
        remark += "; in brackets the thesis's"
    return remark


def _table(rows: Sequence[Row]) -> list[str]:
    """Return a line for each method, a column for each metric."""
    units = {row.metric: "" if row.unit == "1" else f" [{row.unit}]" for row in rows}
    cells = {(row.method, row.metric): _cell(row) for row in rows}
    head = ["method", *(f"{metric}{unit}" for metric, unit in units.items())]
    lines = [head, ["---"] * len(head)]
    methods = dict.fromkeys(row.method for row in rows)
    lines += [[method, *(cells.get((method, metric), "") for metric in units)] for method in methods]
    return [f"| {' | '.join(line)} |" for line in lines]


def _cell(row: Row) -> str:
    spread = f" ± {row.std:.2g}" if len(row.values) > 1 else ""
    thesis = "" if row.thesis is None else f" ({row.thesis:g})"
    return f"{row.mean:.4g}{spread}{thesis}"


def _dump(content: Mapping[str, Any]) -> str:
    """Return the JSON: a line for each field and row; figures, which are long, on one line."""
    figures = content.get("figures")
    text = json.dumps({key: value for key, value in content.items() if key != "figures"}, indent=1)
    return f"{text}\n" if figures is None else f'{text[:-2]},\n "figures": {json.dumps(figures)}\n}}\n'


def _origin() -> Origin:
    """Return the running command, and the commit of the working folder."""
    return Origin(command=" ".join([Path(sys.argv[0]).name, *sys.argv[1:]]), commit=_commit())


def _commit() -> str:
    """Return the commit of the working folder, empty where there is none."""
    try:
        answer = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return answer.stdout.strip()
