"""Atomic file writing: readers never see a partial file."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path


def atomic_write(path: Path, content: bytes | str) -> None:
    """Write a file atomically through a temporary file beside it; text as UTF-8.

    Raises:
        OSError: The file cannot be written; the error names it, and the old file is unchanged.
    """
    temporary = temporary_beside(path)
    try:
        with temporary.open("xb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        # The original error would name the temporary file or, on a full disk, none.
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)


def temporary_beside(path: Path) -> Path:
    """Return a unique temporary path beside another path.

    A process id would not be unique: in a container it is the same for each run, and a killed run leaves its file
    behind.
    """
    return path.with_name(f".{path.name}.{secrets.randbits(60)}.tmp")


def is_temporary(path: Path) -> bool:
    """Return whether a file is a temporary file of `atomic_write`, left behind by a killed run."""
    return re.fullmatch(r"\..+\.\d+\.tmp", path.name) is not None
