"""A lock on a folder, held by one process at a time."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ctrl_rl_core.errors import CtrlRlError


class LockError(CtrlRlError):
    """Another process is using a folder."""


@contextmanager
def exclusive_lock(lock: Path) -> Iterator[None]:
    """Hold a lock within the block; the lock is released even if the process is killed.

    Args:
        lock: Path of an empty lock file in the folder, which is created and kept.

    Raises:
        LockError: Another process holds the lock.
        OSError: The folder is missing or cannot be written to.
    """
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LockError(
                f"{lock.parent}: another process is using this folder: wait until it has ended, or name another folder"
            ) from None
        yield
