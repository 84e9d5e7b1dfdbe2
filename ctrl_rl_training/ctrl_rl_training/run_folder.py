"""Where a run leaves what it learnt."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol


class Named(Protocol):
    """A run, as far as its folder matters."""

    @property
    def name(self) -> str:
        """Name of it, and of its folder."""


def result_file(folder: Path, run: Named) -> Path:
    """Return the file that says that a run is finished, and how it went."""
    return folder / run.name / "result.json"
