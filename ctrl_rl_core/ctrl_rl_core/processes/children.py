"""Child processes that end with their parent in every case, so none keeps driving a robot or filling a disk."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

_SET_PARENT_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of prctl(2)."""
_LIBC = ctypes.CDLL(None)
_WRAPPERS = ("run", "launch")
"""`ros2` verbs that start nodes and wait for them."""


def start_child(command: Sequence[str | Path], **options: Any) -> subprocess.Popen[bytes]:
    """Start a process that receives SIGTERM when this one ends, even by SIGKILL; call from the main thread.

    Args:
        command: Executable and its arguments.
        options: Options of `subprocess.Popen`.
    """
    return subprocess.Popen(command, preexec_fn=partial(_become_child, os.getpid()), **options)


def end_child(process: subprocess.Popen[bytes], patience: float) -> None:
    """End a process in good order, or by SIGKILL if it takes longer than `patience` [s]."""
    process.terminate()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def end_with_ros2() -> None:
    """Have this process receive SIGTERM when the `ros2 run` or `ros2 launch` that started it ends.

    Without this, `ros2 run` and `ros2 launch` leave their children running after SIGTERM, SIGHUP or SIGKILL, and the
    robot keeps driving.
    """
    parent = os.getppid()
    try:
        words = Path(f"/proc/{parent}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return
    names = [os.path.basename(word.decode(errors="replace")) for word in words[:4]]
    if any(verb in _WRAPPERS for name, verb in pairwise(names) if name == "ros2"):
        _end_with(parent)


def _become_child(parent: int) -> None:
    """Reset signals between fork and exec, where the parent's handler would swallow them."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _end_with(parent)


def _end_with(parent: int) -> None:
    """Request SIGTERM from the kernel for when the parent ends; send it now if the parent has already ended."""
    if hasattr(_LIBC, "prctl"):
        _LIBC.prctl(_SET_PARENT_DEATH_SIGNAL, int(signal.SIGTERM), 0, 0, 0)
        if os.getppid() != parent:
            signal.raise_signal(signal.SIGTERM)
