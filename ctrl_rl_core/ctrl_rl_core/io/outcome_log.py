"""Log of trial outcomes, one JSON line each, so that interrupted trials can resume."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar

from pydantic import TypeAdapter

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.checked_json import DIGEST, digest, parse_json, warn_missing_digest
from ctrl_rl_core.io.file_checks import FileError, as_text, one_line, raise_as, read_bytes, short_path

_LARGEST = 64_000_000
_Outcome = TypeVar("_Outcome")


class OutcomeLog(Generic[_Outcome]):
    """A file with the trial settings in its first line, and one outcome in each further line.

    Each line ends with a digest of itself and the previous line, so that a changed, moved or removed line is detected.
    Only one process at a time may add outcomes.

    Attributes:
        outcomes: Outcomes recorded so far.
    """

    def __init__(self, file: Path, settings: Mapping[str, Any], kind: type[_Outcome], error: type[CtrlRlError]) -> None:
        """Read a log, or start a new one.

        Args:
            file: Path of the log; it need not exist.
            settings: Settings common to all its trials, as JSON.
            kind: Dataclass of the outcomes.
            error: Error class to raise for an invalid file.

        Raises:
            CtrlRlError: The file is damaged, or its trials had other settings.
            OSError: The file cannot be written.
        """
        self._file, self._kind, self._error = file, TypeAdapter(kind), error
        self.outcomes: list[_Outcome] = []
        self._stream: BinaryIO | None = None
        self._last = ""
        if file.exists():
            self._read(settings)
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            self._whole = self._line(settings)
            atomic_write(file, self._whole)
            self._size = len(self._whole)

    def add(self, outcome: _Outcome) -> None:
        """Append an outcome.

        Raises:
            CtrlRlError: Another process is adding to the file.
        """
        if self._stream is None:
            self._stream = self._locked()
        self.outcomes.append(outcome)
        self._stream.write(self._line(asdict(outcome)))  # type: ignore[call-overload]
        self._stream.flush()

    def _locked(self) -> BinaryIO:
        """Open the file for appending, and lock it until this process or object ends."""
        stream = self._file.open("r+b")
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            same = os.fstat(stream.fileno()).st_size == self._size
        except BlockingIOError:
            same = False
        if not same:
            stream.close()
            raise self._error(f"{short_path(self._file)}: another call adds to it: wait until it has ended, call again")
        stream.write(self._whole)  # drop a partial line left by a kill
        stream.truncate()
        return stream

    def _line(self, content: Mapping[str, Any]) -> bytes:
        """Return a line with its digest, which the next line's digest includes."""
        plain = json.loads(json.dumps(dict(content)))
        self._last = digest({"before": self._last, "line": plain})
        return f"{json.dumps({**plain, DIGEST: self._last})}\n".encode()

    def _content(self, line: str) -> Any:
        """Verify a line's digest and return its content.

        Raises:
            FileError: This line or the one before was changed.
        """
        content = parse_json(line)
        found = content.pop(DIGEST, None) if isinstance(content, dict) else None
        if found is None and not self._last:  # written by an earlier version
            return content
        if found != digest({"before": self._last, "line": content}):
            raise FileError("a line does not match its digest: it is damaged, or was changed by hand")
        self._last = found
        return content

    def _read(self, settings: Mapping[str, Any]) -> None:
        with raise_as(self._error, self._file, "delete it to repeat its drives"):
            text = as_text(read_bytes(self._file, _LARGEST))
            whole = text[: text.rfind("\n") + 1]  # a kill may leave a partial line
            first, *others = whole.splitlines() or [""]
            before, *rest = [self._content(line) for line in (first, *others)]
            self.outcomes = [self._kind.validate_json(json.dumps(each)) for each in rest]
        if before != settings:
            was = one_line(json.dumps(before), 300)
            raise self._error(
                f"{short_path(self._file)}: has drives with other settings, {was}: delete it, or give another --folder"
            )
        self._size, self._whole = len(text.encode()), whole.encode()
        if not self._last:
            warn_missing_digest(self._file)
            self._whole = b"".join(map(self._line, (before, *rest)))
