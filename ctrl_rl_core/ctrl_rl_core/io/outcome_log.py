"""The outcomes of trials, one JSON line each: trials that were ended go on where they were."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import TypeAdapter

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.checked_json import parse_json
from ctrl_rl_core.io.file_checks import as_text, one_line, raise_as, read_bytes, short_path

_LARGEST = 64_000_000
_Outcome = TypeVar("_Outcome")


class OutcomeLog(Generic[_Outcome]):
    """A file with the settings of trials in its first line, and an outcome in each further one.

    Attributes:
        outcomes: Outcomes of the trials so far.
    """

    def __init__(self, file: Path, settings: Mapping[str, Any], kind: type[_Outcome], error: type[CtrlRlError]) -> None:
        """Read a log, or begin one.

        Args:
            file: File of the log; it need not exist.
            settings: Settings that all its trials share, as JSON.
            kind: Dataclass of the outcomes.
            error: Error to raise for a file that does not serve.

        Raises:
            CtrlRlError: The file is damaged, or its trials had other settings.
            OSError: The file cannot be written.
        """
        self._file, self._kind, self._error = file, TypeAdapter(kind), error
        self.outcomes: list[_Outcome] = []
        if file.exists():
            self._read(settings)
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(file, f"{json.dumps(dict(settings))}\n")

    def add(self, outcome: _Outcome) -> None:
        """Append an outcome."""
        self.outcomes.append(outcome)
        with self._file.open("a") as stream:
            stream.write(f"{json.dumps(asdict(outcome))}\n")  # type: ignore[call-overload]

    def _read(self, settings: Mapping[str, Any]) -> None:
        with raise_as(self._error, self._file, "delete it to have its drives made again"):
            text = as_text(read_bytes(self._file, _LARGEST))
            whole = text[: text.rfind("\n") + 1]  # a kill may leave half a line
            first, *others = whole.splitlines() or [""]
            before = parse_json(first)
            self.outcomes = [self._kind.validate_json(line) for line in others]
        if before != settings:
            was = one_line(json.dumps(before), 300)
            raise self._error(
                f"{short_path(self._file)}: has drives with other settings, {was}: delete it, or give another --folder"
            )
        if whole != text:
            atomic_write(self._file, whole)
