"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import re
from pathlib import Path


def atomic_write(path: Path, content: bytes | str) -> None:
    """Write a file through a temporary one beside it; text as UTF-8. A reader or a crash never meets half of it.

    Raises:
        OSError: the disk refuses; it names the file, and what was there before still is.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
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


def is_temporary(path: Path) -> bool:
    """Whether a file is one that `atomic_write` writes through, or was killed over."""
    return re.fullmatch(r"\..+\.\d+\.tmp", path.name) is not None
