"""The outcomes of trials, one JSON line each: trials that were ended go on where they were."""

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
    """A file with the settings of trials in its first line, and an outcome in each further one.

    Each line ends with a digest of itself and of the one before, so that a line that was changed, moved or taken out
    is noticed. One process at a time adds outcomes.

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
            CtrlRlError: Another process adds to the file.
        """
        if self._stream is None:
            self._stream = self._locked()
        self.outcomes.append(outcome)
        self._stream.write(self._line(asdict(outcome)))  # type: ignore[call-overload]
        self._stream.flush()

    def _locked(self) -> BinaryIO:
        """Open the file to add to it; it stays locked until this process or this object ends."""
        stream = self._file.open("r+b")
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            same = os.fstat(stream.fileno()).st_size == self._size
        except BlockingIOError:
            same = False
        if not same:
            stream.close()
            raise self._error(f"{short_path(self._file)}: another call adds to it: wait until it has ended, call again")
        stream.write(self._whole)  # without half a line that a kill left
        stream.truncate()
        return stream

    def _line(self, content: Mapping[str, Any]) -> bytes:
        """Return a line with its digest, which the next one counts in."""
        plain = json.loads(json.dumps(dict(content)))
        self._last = digest({"before": self._last, "line": plain})
        return f"{json.dumps({**plain, DIGEST: self._last})}\n".encode()

    def _content(self, line: str) -> Any:
        """Return a line's content, whose digest is checked.

        Raises:
            FileError: It was changed, or the one before it was.
        """
        content = parse_json(line)
        found = content.pop(DIGEST, None) if isinstance(content, dict) else None
        if found is None and not self._last:  # of an earlier version
            return content
        if found != digest({"before": self._last, "line": content}):
            raise FileError("a line does not match its digest: it is damaged, or was changed by hand")
        self._last = found
        return content

    def _read(self, settings: Mapping[str, Any]) -> None:
        with raise_as(self._error, self._file, "delete it to have its drives made again"):
            text = as_text(read_bytes(self._file, _LARGEST))
            whole = text[: text.rfind("\n") + 1]  # a kill may leave half a line
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
