"""Work that a file of others decides about, in a process of bounded memory and time, and in an empty folder."""

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
    """Work was refused by its process, or took more memory or time than it may."""


def run_limited(module: str, words: Sequence[str], content: bytes, seconds: float, memory: int) -> str:
    """Run `python -m module words` on a content, and return what it prints.

    The module calls `limit_memory` before it looks at its standard input.

    Args:
        module: Module to run.
        words: Its arguments, before the memory.
        content: Its standard input.
        seconds: Time that it may take, of a clock on the wall [s].
        memory: Bytes that it may take beside Python and its libraries; its last argument.

    Raises:
        LimitError: It failed, with the last line of what it says, or it took too long or too much.
    """
    with TemporaryDirectory(prefix="limited-") as folder:  # nothing lies there that a file could refer to
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
        raise LimitError(f"takes more than {memory >> 20} MB, or breaks what reads it" if ended else said[-1][:_SHOWN])
    return done.stdout.decode(errors="replace").strip()


def limit_memory(memory: int) -> None:
    """Let this process take so many bytes more than it has now."""
    resource.setrlimit(resource.RLIMIT_AS, (_address_space() + memory, resource.RLIM_INFINITY))


@contextmanager
def limited_memory(memory: int) -> Iterator[None]:
    """Let the block take so many bytes more than the process has; beyond it, what asks for memory fails."""
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
