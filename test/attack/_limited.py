"""A command under attack, in a process with limits of memory and time."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def run_limited(
    what: str, words: Sequence[str | Path], memory: int, seconds: float
) -> subprocess.CompletedProcess[str]:
    """Run Python with these words and return the process, which has ended with 0 or 1.

    Args:
        what: Name of the command, for the finding.
        words: Arguments of the interpreter.
        memory: Address space [bytes].
        seconds: Time after which it hangs [s].

    Raises:
        AssertionError: It hangs, ends in another way, shows a traceback, or says more than one line where it refuses.
    """
    try:
        done = subprocess.run(
            [sys.executable, *words],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=seconds,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (memory, memory)),
        )
    except subprocess.TimeoutExpired:
        raise AssertionError(f"{what} hangs") from None
    said = done.stderr.strip()
    assert done.returncode in (0, 1), f"{what} ended with {done.returncode}: {said[-2000:]}"
    assert "Traceback" not in said, f"{what}: {said[-2000:]}"
    if done.returncode == 1:
        assert len(said.splitlines()) == 1, f"{what} says {said[-2000:]}"
    return done
