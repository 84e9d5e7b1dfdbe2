"""Writes files atomically: a reader never sees half a file."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path


def atomic_write(path: Path, content: bytes | str) -> None:
    """Write a file through a temporary one beside it; text as UTF-8. A crash leaves the old file or the new one.

    Raises:
        OSError: The file cannot be written; the error names it, and the old file is still there.
    """
    temporary = temporary_beside(path)
    try:
        with temporary.open("xb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        # As it comes it names the temporary file, or with a full disk none.
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)


def temporary_beside(path: Path) -> Path:
    """Return a path beside another one where nobody else writes.

    A process id would not do: in a container it is the same in each run, and a run that was killed leaves its file.
    """
    return path.with_name(f".{path.name}.{secrets.randbits(60)}.tmp")


def is_temporary(path: Path) -> bool:
    """Tell whether a file is a temporary one of `atomic_write`, left by a run that was killed."""
    return re.fullmatch(r"\..+\.\d+\.tmp", path.name) is not None
