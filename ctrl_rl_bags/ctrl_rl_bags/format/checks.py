"""Checks of possibly hostile bags: errors, regular files only, and YAML of bounded size and depth.

A bag's YAML may be longer than `checked_yaml` allows, because it contains the parameters of all nodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from ctrl_rl_core.io import FileError, one_line, open_file

from ctrl_rl_core import CtrlRlError

_LONGEST_REASON = 200
_LARGEST_YAML = 8 << 20
_DEEPEST_YAML = 20
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class BagError(CtrlRlError):
    """A bag cannot be written, read or recovered; the message names the file and the remedy."""


class DamagedError(BagError):
    """A file is damaged or exceeds the limits; the message does not name it."""


class LargeChunkError(DamagedError):
    """A chunk exceeds the limit.

    Args:
        size: Uncompressed size of the chunk [bytes].
        limit: Limit [bytes].
    """

    def __init__(self, size: int, limit: int) -> None:
        super().__init__(f"a chunk of {size:,} bytes, where at most {limit:,} are read")
        self.megabytes = -(-size // (1 << 20))


def reason(error: Exception) -> str:
    """Format any error as part of one printable line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return printable(" ".join(str(error)[: 10 * _LONGEST_REASON].split()) or type(error).__name__)


@contextmanager
def fields_of(what: str) -> Iterator[None]:
    """Convert errors about missing or invalid fields to BagError, since a bag defines its own types.

    Raises:
        BagError: The message starts with `what`.
    """
    try:
        yield
    except (AttributeError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise BagError(f"{what} is not what its type says: {reason(error)}") from None


def printable(text: str, longest: int = _LONGEST_REASON) -> str:
    """Make a text from a bag safe to print: bounded length, no line breaks, no escape sequences."""
    return one_line(text, longest)


@contextmanager
def open_regular(path: Path, largest: float = math.inf) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file; yield it and its size [bytes].

    Raises:
        DamagedError: The file is not regular, or is larger than `largest` [bytes].
        OSError: The file cannot be opened.
    """
    try:
        with open_file(path, largest) as opened:
            yield opened
    except FileError as error:
        raise DamagedError(f"it {error}" if str(error).startswith(("is ", "has ")) else str(error)) from None


def read_yaml(path: Path) -> Any:
    """Read a YAML file.

    Raises:
        DamagedError: The file is too large, or is not plain YAML.
        OSError: The file cannot be read.
    """
    with open_regular(path, _LARGEST_YAML) as (stream, size):
        return parse_yaml(stream.read(size))


def parse_yaml(text: str | bytes) -> Any:
    """Parse a YAML text.

    Raises:
        DamagedError: The text is not YAML, is too large or too deep, or has aliases, which can expand without bound.
    """
    if len(text) > _LARGEST_YAML:
        raise DamagedError(f"it has {len(text):,} characters, where at most {_LARGEST_YAML:,} are read")
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise DamagedError("it has an alias, which is not allowed")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST_YAML:
                raise DamagedError(f"it is nested more than {_DEEPEST_YAML} levels deep")
        return yaml.load(text, _LOADER)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise DamagedError(f"it is not YAML: {reason(error)}") from None
