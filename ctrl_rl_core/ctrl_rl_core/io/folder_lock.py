"""A folder lock that processes wait for, so that only one at a time reads, changes and writes its files."""

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
    """Wait for a folder's lock and hold it within the block; nested blocks are allowed.

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
