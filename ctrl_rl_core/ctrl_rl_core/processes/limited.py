"""Runs work on untrusted files in a process with limited memory and time, in an empty folder."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from ctrl_rl_core.errors import CtrlRlError

_SHOWN = 400


class LimitError(CtrlRlError):
    """The process rejected its work, or exceeded its memory or time limit."""


def run_limited(module: str, words: Sequence[str], content: bytes, seconds: float, memory: int) -> str:
    """Run `python -m module words` with the content on standard input, and return its output.

    The module must call `limit_memory` before it reads standard input.

    Args:
        module: Module to run.
        words: Arguments of the module, before the memory limit.
        content: Standard input.
        seconds: Wall-time limit [s].
        memory: Memory limit beyond Python and its libraries [bytes]; passed as the last argument.

    Raises:
        LimitError: The module failed (with the last line of its output), or exceeded a limit.
    """
    with TemporaryDirectory(prefix="limited-") as folder:  # an empty folder, so a file cannot refer to anything in it
        try:
            done = subprocess.run(
                [sys.executable, "-m", module, *words, str(memory)],
                input=content,
                capture_output=True,
                check=False,
                timeout=seconds,
                cwd=folder,
            )
        except subprocess.TimeoutExpired:
            raise LimitError(f"takes more than {seconds:g} s") from None
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines() or [""]
        ended = done.returncode < 0 or "MemoryError" in said[-1] or "bad_alloc" in said[-1]
        raise LimitError(f"takes more than {memory >> 20} MB, or crashes its reader" if ended else said[-1][:_SHOWN])
    return done.stdout.decode(errors="replace").strip()


def limit_memory(memory: int) -> None:
    """Limit this process to this many bytes more than it uses now."""
    resource.setrlimit(resource.RLIMIT_AS, (_address_space() + memory, resource.RLIM_INFINITY))


@contextmanager
def limited_memory(memory: int) -> Iterator[None]:
    """Limit the block to this many bytes more than the process uses; allocations beyond that fail."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = _address_space() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit if before[0] < 0 else min(limit, before[0]), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _address_space() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return pages * resource.getpagesize()
