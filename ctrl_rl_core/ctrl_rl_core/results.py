"""Results as data: one JSON file per experiment, from which tables and plots are made."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Result:
    """One row: a method's figure, one value per seed, beside the thesis's where it has one."""

    method: str
    metric: str
    unit: str
    values: Sequence[float]
    thesis: float | None = None


def write_results(path: Path, experiment: str, seeds: Sequence[int], rows: Sequence[Result]) -> None:
    """Write an experiment's rows, with the command and commit that gave them; the file is there whole or not at all."""
    content = {
        "experiment": experiment,
        "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "commit": _commit(),
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
            }
            for row in rows
        ],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    temporary.replace(path)


def _commit() -> str:
    """Return the commit of the working folder, empty where there is none."""
    try:
        answer = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return answer.stdout.strip()
