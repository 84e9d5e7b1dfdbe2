"""Random systems with known times to reach, from the referee's families: the solver's times against them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from _attack import Attack

sys.path.insert(0, str(Path(__file__).parent.parent))

from referee.command import describe, try_seed

SEEDS = 2**31


def against_referee(random: np.random.Generator, _folder: Path) -> None:
    """Hold the solution of one system to its reference."""
    verdict = try_seed(int(random.integers(SEEDS)))
    assert not verdict.wrong, f"{describe(verdict)}\nagain: python test/referee --only {verdict.seed}"


ATTACKS = (
    Attack(
        "values-referee",
        "Times to reach of random systems are those of the referee; no state is called unreachable that is not.",
        against_referee,
        limit_s=600.0,
    ),
)
