"""The page of results: a collapsible table for each results file, under a readable heading."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.io.results import Benchmark, Experiment, Origin, Row, read_benchmarks, read_experiment, spread_of

_BENCHMARKS = "bench.json"
_KINDS = (
    (r"koopman_(figure|table)_([\d.]+)_(.*)", r"Koopman control, \1 \2: \3"),
    (r"koopman_(.*)", r"Koopman control: \1"),
    (r"oc_training_(.*)", r"Learning with an optimal-control baseline: \1"),
    (r"oc_values_(.*)", r"Optimal-control value: \1"),
    (r"oc_(.*)", r"Optimal control: \1"),
    (r"options_(.*)", r"Joint options: \1"),
    (r"offline_(.*)", r"Offline learning: \1"),
    (r"ttr_training_(.*)_ttr", r"Learning by the time to reach: \1"),
    (r"ttr_(.*)", r"Time to reach: \1"),
)
"""Readable names for the name parts of results files."""
_SPELT = {"barn": "BARN", "mpc": "MPC", "onnx": "ONNX", "quad": "quadrotor"}


def results_page(folder: Path, link: str = "results") -> str:
    """Return the results of a folder as a page of tables, with the thesis's or other published values alongside.

    Args:
        folder: Folder with the JSON files.
        link: Path of the folder relative to the page.

    Raises:
        ResultsError: A file cannot be read or has other content.
    """
    lines = ["# Results", "", "Made from the JSON files in `docs/results/` by `make results`; do not edit."]
    for file in sorted(folder.glob("*.json")):
        experiment = read_experiment(file)
        if experiment is not None:
            what = f"{len(experiment.rows)} rows{_notation(experiment)}; [data]({link}/{file.name})"
            lines += ["", f"## {heading(file.stem)}", "", what, "", '<details markdown="1">']
            lines += ["<summary>Commands and table</summary>", "", *_head(experiment), "", *_table(experiment.rows)]
            lines += ["", "</details>"]
    return "\n".join([*lines, *benchmark_lines(read_benchmarks(folder / _BENCHMARKS))]) + "\n"


def heading(stem: str) -> str:
    """Return the readable name of a results file."""
    words = next((re.sub(name, words, stem) for name, words in _KINDS if re.fullmatch(name, stem)), stem)
    spelt = [_SPELT.get(word, word) for word in re.split(r"[_ ]", words)]
    text = " ".join(spelt)
    return text[0].upper() + text[1:]


def benchmark_lines(benchmarks: Sequence[Benchmark]) -> list[str]:
    """Return the lines of the benchmark table; empty without benchmarks."""
    if not benchmarks:
        return []
    lines = ["", "## Benchmarks", "", "    make bench", "", "Each figure and its peer were measured in one run."]
    lines += ["", "| what | ours | against | ratio |", "|---|---|---|---|"]
    for row in benchmarks:
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        lines.append(f"| {row.name} | {row.value:.4g} {row.unit} | {row.against} | {ratio} |")
    return lines


def _head(experiment: Experiment) -> list[str]:
    """Return the commands that measured an experiment's rows, and the notation of its values."""
    methods: dict[Origin, dict[str, None]] = {}
    for row in experiment.rows:
        for origin in row.origins:
            methods.setdefault(origin, {})[row.method] = None
    if not methods:
        return [f"    {experiment.command}", "", f"Commit {experiment.commit}."]
    lines: list[str] = []
    for origin, measured in methods.items():
        lines += [f"    {origin.command}", "", f"Commit {origin.commit}: {'; '.join(measured)}.", ""]
    return lines[:-1] if all(row.origins for row in experiment.rows) else [*lines, "The other rows are older."]


def _notation(experiment: Experiment) -> str:
    """Describe the number of seeds behind the values, and the spread shown next to a mean."""
    remark = ""
    if len(experiment.seeds) > 1:
        counts: dict[str, int] = {}
        for row in experiment.rows:
            counts[row.method] = max(counts.get(row.method, 0), len(row.values))
        most = max(counts.values(), default=0)
        up_to = "" if len(set(counts.values())) <= 1 else "up to "
        remark += f", {up_to}{most} seeds, mean and sample standard deviation over them"
    elif any(len(row.values) > 1 for row in experiment.rows):
        remark += ", mean and sample standard deviation"
    if any(row.thesis is not None for row in experiment.rows):
        remark += "; in brackets the thesis's"
    return remark


def _table(rows: Sequence[Row]) -> list[str]:
    """Return a table with a row per method and a column per metric."""
    units = {row.metric: "" if row.unit == "1" else f" [{row.unit}]" for row in rows}
    cells = {(row.method, row.metric): _cell(row) for row in rows}
    head = ["method", *(f"{metric}{unit}" for metric, unit in units.items())]
    lines = [head, ["---"] * len(head)]
    methods = dict.fromkeys(row.method for row in rows)
    lines += [[method, *(cells.get((method, metric), "") for metric in units)] for method in methods]
    return [f"| {' | '.join(line)} |" for line in lines]


def _cell(row: Row) -> str:
    thesis = "" if row.thesis is None else f" ({row.thesis:g})"
    return f"{row.mean:.4g}{spread_of(row.values)}{thesis}"
