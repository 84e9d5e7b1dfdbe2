"""The order of the tests: files that took longest begin first, for a long one that begins last leaves cores idle.

`--record-durations` keeps what each file of a run takes in `durations.json`.
"""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import pytest

FILE = Path(__file__).with_name("durations.json")
_ROOT = FILE.parents[1]
_LEAST_S = 1.0
"""Files that take less are not kept, and begin last."""


def recorded() -> dict[str, float]:
    """Return the seconds of each file by its path in the workspace, as last recorded."""
    found: dict[str, float] = json.loads(FILE.read_text("utf-8"))
    return found


def longest_first(items: list[pytest.Item]) -> None:
    """Sort tests by what their files took; those of a file stay together, in their order."""
    seconds = recorded()
    items.sort(key=lambda item: -seconds.get(item.path.relative_to(_ROOT).as_posix(), 0.0))


class Recorder:
    """A plugin that adds up what the tests of each file take, and keeps the sums at the end."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._seconds[report.nodeid.partition("::")[0]] += report.duration

    def pytest_sessionfinish(self) -> None:
        known = recorded() | {file: round(seconds, 1) for file, seconds in self._seconds.items()}
        kept = {file: seconds for file, seconds in known.items() if seconds >= _LEAST_S and (_ROOT / file).is_file()}
        ordered = dict(sorted(kept.items(), key=lambda each: -each[1]))
        FILE.write_text(json.dumps(ordered, indent=1) + "\n", "utf-8")
