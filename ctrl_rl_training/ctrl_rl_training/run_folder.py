"""Where a run leaves what it learnt."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from ctrl_rl_training.errors import TrainingError


class Named(Protocol):
    """A run, as far as its folder matters."""

    @property
    def name(self) -> str:
        """Name of it, and of its folder."""


def result_file(folder: Path, run: Named) -> Path:
    """Return the file that says that a run is finished, and how it went."""
    return folder / run.name / "result.json"


def read_result(file: Path) -> dict[str, Any]:
    """Return what a finished run left, see `result_file`: at least its `run` and its `curve`.

    Raises:
        TrainingError: the file is damaged.
    """
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
        len(result["curve"]), result["run"].items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise TrainingError(f"{file}: is not what a finished run leaves: delete it to have it learnt again") from None
    return dict(result)


def check_same(file: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse a file of a run that was another one.

    Raises:
        TrainingError: names the first difference.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise TrainingError(
                f"{file}: was made with {name} {before.get(name)}, now it is {value}: use another folder, or delete it"
            )
