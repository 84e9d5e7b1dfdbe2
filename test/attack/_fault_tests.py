"""The fault tests of all packages as one attack: what pytest marks `fault`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from _attack import Attack

ROOT = Path(__file__).resolve().parents[2]


def run(generator: np.random.Generator, _folder: Path) -> None:
    """Run every test marked `fault`."""
    command = [sys.executable, "-m", "pytest", "-m", "fault and not slow", "--no-header", "--tb=short"]
    command += ["--hypothesis-profile", "anew", "--hypothesis-seed", str(generator.integers(1 << 31))]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout[-4000:]


FAULT_TESTS = Attack(
    "fault-tests",
    "Each fault that was once found is answered as the table of faults promises.",
    run,
    limit_s=1800.0,
    repeats=False,
)
