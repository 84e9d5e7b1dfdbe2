"""The door that bags come through: their errors, regular files only, and YAML of a bounded size and depth."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from ctrl_rl_core.errors import CtrlRlError

_LONGEST_REASON = 200
_LARGEST_YAML = 8 << 20
_DEEPEST_YAML = 20
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class BagError(CtrlRlError):
    """A bag cannot be written, read or mended; the message names the file and says what to do."""


class DamagedError(BagError):
    """A file is not what it says, or asks for more than the limits allow; the message does not name it."""


def reason(error: Exception) -> str:
    """Return any error as a part of one printable line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return printable(" ".join(str(error)[: 10 * _LONGEST_REASON].split()) or type(error).__name__)


def printable(text: str, longest: int = _LONGEST_REASON) -> str:
    """Return a text of a bag as it may be printed: of a bounded length, without line breaks and escapes."""
    text = text if len(text) <= longest else f"{text[:longest]}..."
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@contextmanager
def open_regular(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file and give it and its size [bytes]; a pipe or a device would never end.

    Raises:
        DamagedError: it is no regular file.
        OSError: it cannot be opened.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    with os.fdopen(descriptor, "rb") as stream:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            raise DamagedError("it is no regular file")
        yield stream, state.st_size


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        DamagedError: it is too large, or no plain YAML.
        OSError: it cannot be read.
    """
    with open_regular(path) as (stream, size):
        if size > _LARGEST_YAML:
            raise DamagedError(f"it has {size:,} bytes, where at most {_LARGEST_YAML:,} are read")
        return parse_yaml(stream.read(_LARGEST_YAML))


def parse_yaml(text: str | bytes) -> Any:
    """Return the content of a YAML text.

    Raises:
        DamagedError: it is no YAML, too large or too deep, or has aliases, which let a short text unfold without end.
    """
    if len(text) > _LARGEST_YAML:
        raise DamagedError(f"it has {len(text):,} characters, where at most {_LARGEST_YAML:,} are read")
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise DamagedError("it has an alias, which no bag needs")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST_YAML:
                raise DamagedError(f"it is nested more than {_DEEPEST_YAML} levels deep")
        return yaml.load(text, _LOADER)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise DamagedError(f"it is no YAML: {reason(error)}") from None
