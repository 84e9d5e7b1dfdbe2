"""Run the benchmarks: each figure beside a peer or a floor that ran in the same run.

python test/benchmarks [--output FILE] [--only NAME ...]
"""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ctrl_rl_core.command import EXIT_USAGE
from tqdm import tqdm

from ctrl_rl_core import atomic_write, parse_options, read_benchmarks

HERE = Path(__file__).parent
NAMES = sorted(file.stem for file in HERE.glob("*.py") if not file.stem.startswith("_"))


@dataclass
class Options:
    """Run benchmarks, print their rows, and write them where asked."""

    output: Path | None = None
    """JSON file to write the rows to; those of other benchmarks stay in it."""
    only: tuple[str, ...] = ()
    """Names of the benchmarks; all where none is given."""


def main() -> int:
    """Run benchmarks and print their rows."""
    options = parse_options("benchmarks", Options)
    if unknown := sorted(set(options.only) - set(NAMES)):
        print(f"benchmarks: no benchmark {unknown[0]}: there are {', '.join(NAMES)}", file=sys.stderr)
        return EXIT_USAGE
    sys.path.insert(0, str(HERE))
    rows: list[dict[str, Any]] = []
    for name in tqdm(options.only or NAMES, desc="benchmarks", disable=None):
        fresh = [{"benchmark": name, **row} for row in importlib.import_module(name).rows()]
        rows += fresh
        if options.output is not None:
            write(options.output, name, fresh)
    print(table(rows))
    return 0


def write(file: Path, name: str, fresh: list[dict[str, Any]]) -> None:
    """Put a benchmark's rows in the place of its former ones; those of others stay."""
    there = [row.model_dump() for row in read_benchmarks(file)]
    kept = [row for row in there if row["benchmark"] in NAMES and row["benchmark"] != name]
    file.parent.mkdir(parents=True, exist_ok=True)
    content = sorted(kept + fresh, key=lambda row: NAMES.index(row["benchmark"]))
    atomic_write(file, json.dumps(content, indent=1) + "\n")


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows for people."""
    lines = []
    for row in rows:
        ratio = "" if row["ratio"] is None else f"{row['ratio']:9.2f} x"
        lines.append(f"{row['name']!s:<52} {row['value']:>12.4g} {row['unit']!s:<14}{ratio:>12}  {row['against']}")
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
