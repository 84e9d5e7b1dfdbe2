"""A study: long work in steps, each of which is done once, however often the work is cut off.

    study = Study(Path("runs/mine"))
    found = study.once("first", lambda: {"success": drive_for_an_hour()})     # read from first.json from then on

Many seeds of a learner are a study of their own kind, see `matrix.run_experiments`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ctrl_rl_core.io import raise_as, read_json, with_digest

from ctrl_rl_core import atomic_write
from ctrl_rl_learning.errors import LearningError


class Study:
    """Results of the steps in a folder.

    Args:
        folder: Folder of the study, made when the first step is done.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def once(self, name: str, work: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """Return the result of a step, as JSON: of an earlier call, or else worked out now.

        Args:
            name: Name of the step; its result is in NAME.json of the folder.
            work: Does the step; may leave the file itself, as another process does.

        Raises:
            LearningError: The file of an earlier call is damaged.
        """
        file = self.folder / f"{name}.json"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            result = work()
            if not file.exists():
                atomic_write(file, json.dumps(with_digest(dict(result))))
        with raise_as(LearningError, file, "delete it to have the step done again"):
            found: dict[str, Any] = read_json(file)
        return found

    def rounds(self, count: int, work: Callable[[int, Path], Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
        """Yield the results of rounds 0 to `count`, each in a folder of its own, which `work` is told."""
        for number in range(count + 1):
            name = f"round_{number}"
            yield self.once(f"{name}/result", lambda number=number, name=name: work(number, self.folder / name))  # type: ignore[misc]
