"""Processes that end with their parent, whatever ends it: nobody is left to drive a robot, or to fill a disk."""

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
"""Verbs of `ros2` that start nodes and wait for them."""


def start_child(command: Sequence[str | Path], **options: Any) -> subprocess.Popen[bytes]:
    """Start a process that gets SIGTERM when this one ends, killed or not; call it in the main thread.

    Args:
        command: Executable and its arguments.
        options: Options of `subprocess.Popen`.
    """
    return subprocess.Popen(command, preexec_fn=partial(_become_child, os.getpid()), **options)


def end_with_ros2() -> None:
    """Let this process get SIGTERM when the `ros2 run` or `ros2 launch` that started it ends.

    ROS's own leave what they started behind when they get a SIGTERM, a SIGHUP or a SIGKILL: a robot would drive on.
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
    """Run between fork and exec: the parent's own handler would swallow the signal there."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _end_with(parent)


def _end_with(parent: int) -> None:
    """Let the kernel send this process SIGTERM when its parent ends; at once where it has ended already."""
    if hasattr(_LIBC, "prctl"):
        _LIBC.prctl(_SET_PARENT_DEATH_SIGNAL, int(signal.SIGTERM), 0, 0, 0)
        if os.getppid() != parent:
            signal.raise_signal(signal.SIGTERM)
