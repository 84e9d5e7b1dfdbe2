"""Opens possibly hostile files: regular files of bounded size only, with one-line errors.

    with raise_as(TaskError, path):
        content = parse_yaml(read_bytes(path, 1_000_000))

Any error within the block becomes a `TaskError` that names the file.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from pydantic import ValidationError

from ctrl_rl_core.errors import CtrlRlError

LONGEST_VALUE = 60
"""Maximum length of an invalid value in an error message [characters]."""
LONGEST_ERROR = 400
"""Maximum length of an error message, without the file name [characters]."""
_LONGEST_NAME = 200
_POINTER, _POINTER_SIZE = b"version https://git-lfs.github.com/spec/", 1024
"""Prefix and maximum size of a Git LFS pointer file."""


class FileError(CtrlRlError):
    """A file is invalid; `raise_as` adds the file name to the message."""


def one_line(text: object, longest: int = LONGEST_ERROR) -> str:
    """Return a text as one printable line: unprintable characters are escaped, and a long text is cut."""
    said = str(text)
    said = said if len(said) <= longest else f"{said[: longest - 3]}..."
    if not said.isprintable():
        said = "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in said)
    return said


def short_repr(value: object) -> str:
    """Return an invalid value as a short piece of an error message."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**LONGEST_VALUE:
        return "a number of more than 60 digits"
    if isinstance(value, str):
        value = value[: 2 * LONGEST_VALUE]
    elif not isinstance(value, int | float | None):
        return f"a {type(value).__name__}"
    return one_line(repr(value), LONGEST_VALUE)


def short_path(path: str | os.PathLike[str]) -> str:
    """Return a path as a short piece of an error message; a long path is cut at its beginning."""
    said = os.fspath(path)
    return one_line(said if len(said) <= _LONGEST_NAME else f"...{said[-_LONGEST_NAME:]}", 2 * _LONGEST_NAME)


@contextmanager
def raise_as(kind: type[CtrlRlError], path: str | os.PathLike[str], advice: str = "") -> Iterator[None]:
    """Convert any error about a file to one error class, with a one-line message that starts with the file name.

    Args:
        kind: Class of the error to raise.
        path: Path of the file.
        advice: How to repair a bad file, as a sentence for the user.
    """
    try:
        yield
    except ValidationError as error:
        fault = first_error(error)
    except OSError as error:
        raise kind(f"{short_path(path)}: cannot be read: {one_line(error.strerror or error)}") from None
    except MemoryError:
        raise kind(f"{short_path(path)}: does not fit into memory") from None
    except CtrlRlError as error:
        if str(error).startswith(f"{short_path(path)}: "):  # raised by an inner reader
            raise kind(str(error)) from None
        fault = one_line(error)
    else:
        return
    raise kind(f"{short_path(path)}: {fault}{f': {advice}' if advice else ''}") from None


@contextmanager
def open_file(path: str | os.PathLike[str], largest: float) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file of at most `largest` bytes; yield it and its size [bytes].

    Raises:
        FileError: The file is missing, too large, a folder, a pipe, a device or a Git LFS pointer.
        OSError: The file cannot be read.
    """
    try:
        # Opening a pipe would block until someone writes to it.
        descriptor = os.open(Path(path).expanduser(), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except (FileNotFoundError, NotADirectoryError):
        raise FileError("there is no such file") from None
    except (ValueError, RuntimeError) as error:  # a null byte in the name, or no home folder
        raise FileError(f"is not the name of a file ({error})") from None
    try:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            raise FileError("is a folder" if stat.S_ISDIR(state.st_mode) else "is no regular file")
        if state.st_size > largest:
            raise FileError(f"is too large: {state.st_size:,} bytes, at most {largest:,.0f} are read")
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            if state.st_size < _POINTER_SIZE and file.read(len(_POINTER)) == _POINTER:
                raise FileError("is a Git LFS pointer in place of the file: run git lfs pull")
            file.seek(0)
            yield file, state.st_size
    finally:
        os.close(descriptor)


def read_bytes(path: str | os.PathLike[str], largest: float) -> bytes:
    """Return the contents of a regular file of at most `largest` bytes.

    Raises:
        FileError, OSError: As for `open_file`.
    """
    with open_file(path, largest) as (file, size):
        return file.read(size)


def as_text(content: bytes) -> str:
    """Decode the text of a file.

    Raises:
        FileError: The text is not UTF-8.
    """
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise FileError(f"is not text: byte {error.start} is not UTF-8") from None


_SAID = {
    "extra_forbidden": "no such key",
    "missing": "is missing",
    "model_type": "must hold entries, `name: value`",
    "dict_type": "must hold entries, `name: value`",
    "model_attributes_type": "must hold entries, `name: value`",
    "union_tag_not_found": "{discriminator} is missing",
    "union_tag_invalid": "{discriminator} is '{tag}': must be one of {expected_tags}",
}
"""Schema error messages in the terms of the file, by error type."""


def first_error(error: ValidationError, hidden: tuple[str, ...] = ()) -> str:
    """Return a schema's first error as `key.key: message`, and the number of further errors.

    Args:
        error: Error that the schema raised.
        hidden: Key components that belong to the schema rather than the file.
    """
    errors = error.errors(include_url=False)
    first: Any = errors[0]
    key = ".".join(str(part) for part in first["loc"] if part not in hidden)
    given = first["input"]
    said = _SAID.get(first["type"])
    text = first["msg"] if said is None else said.format(**first.get("ctx", {}))
    if said is None and not text.startswith("Value error, ") and isinstance(given, str | int | float | None):
        text = f"is {short_repr(given)}: {text}"
    text = text.removeprefix("Value error, ").replace("Input should be", "must be", 1)
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    line = f"{one_line(key, 100)}: {text}" if key else text
    return f"{one_line(line, LONGEST_ERROR - 20)}{more}"


def available_memory() -> float:
    """Return the memory that can be allocated [bytes]: the system's, or less if this process's cgroup is limited."""
    bytes_ = float("inf")
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                bytes_ = 1024.0 * float(line.split()[1])
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        if limit != "max":
            used = float(Path("/sys/fs/cgroup/memory.current").read_text(encoding="ascii"))
            bytes_ = min(bytes_, float(limit) - used)
    except (OSError, ValueError):
        pass  # not Linux, or no cgroup: the limit is unknown, so nothing is rejected
    return bytes_
