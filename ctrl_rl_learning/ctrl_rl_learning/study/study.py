"""A study: long work in steps, each done only once even if the work is interrupted.

    study = Study(Path("runs/mine"))
    found = study.once("first", lambda: {"success": drive_for_an_hour()})     # later calls read first.json

For many seeds of a learner see `matrix.run_experiments`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ctrl_rl_core.io import raise_as, read_json, with_digest

from ctrl_rl_core import atomic_write
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.study.run import check_same


class Study:
    """Step results of a study, stored in a folder.

    Args:
        folder: Folder of the study, created when the first step finishes.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def once(self, name: str, work: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """Return the result of a step, as JSON: stored by an earlier call, or computed now.

        Args:
            name: Name of the step; NAME.json in the folder holds its result.
            work: Function that does the step; it may write the file itself, e.g. from another process.

        Raises:
            LearningError: The file of an earlier call is damaged.
        """
        file = self.folder / f"{name}.json"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            result = work()
            if not file.exists():
                atomic_write(file, json.dumps(with_digest(dict(result))))
        with raise_as(LearningError, file, "delete it to repeat the step"):
            found: dict[str, Any] = read_json(file)
        return found

    def require_same(self, settings: Mapping[str, Any]) -> None:
        """Store the study's settings, or check that its finished steps had the same.

        Args:
            settings: JSON values of the settings on which the steps' results depend, by name.

        Raises:
            LearningError: A setting differs from that of an earlier call; its file is damaged.
        """
        check_same(self.folder, self.once("settings", lambda: settings), settings)

    def rounds(self, count: int, work: Callable[[int, Path], Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
        """Yield the results of rounds 0 to `count`; `work` gets each round's number and its own folder."""
        for number in range(count + 1):
            name = f"round_{number}"
            yield self.once(f"{name}/result", lambda number=number, name=name: work(number, self.folder / name))  # type: ignore[misc]
