"""A lock on a folder for which processes wait, so that files in it are read, changed and written by one at a time."""

from __future__ import annotations

import fcntl
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_held = threading.local()


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Wait until no other process is within such a block of a folder, and hold it; a block within a block is let in.

    Raises:
        OSError: The folder is missing.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        state = os.fstat(descriptor)
        key = state.st_dev, state.st_ino
        inside: set[tuple[int, int]] = vars(_held).setdefault("folders", set())
        if key in inside:
            yield
            return
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        inside.add(key)
        try:
            yield
        finally:
            inside.discard(key)
    finally:
        os.close(descriptor)
