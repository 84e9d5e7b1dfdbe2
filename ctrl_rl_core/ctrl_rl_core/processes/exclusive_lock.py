"""A lock on a folder that one process at a time holds."""

from __future__ import annotations

import fcntl
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ctrl_rl_core.errors import CtrlRlError


_held = threading.local()


class LockError(CtrlRlError):
    """Another process is at work in a folder."""


@contextmanager
def exclusive_lock(lock: Path) -> Iterator[None]:
    """Hold a lock within the block; it ends with the process, however that ends.

    Args:
        lock: Path of an empty file in the folder, which is created and left there.

    Raises:
        LockError: Another process holds it.
        OSError: The folder is missing or cannot be written to.
    """
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LockError(
                f"{lock.parent}: another call is at work there: wait until it has ended, or name another folder"
            ) from None
        yield


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
