"""Random systems with known times to reach, from the referee's families: the solver's times against them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from _attack import Attack

sys.path.insert(0, str(Path(__file__).parent.parent))

from referee.command import describe, try_seed

SEEDS = 2**31
LOST = 0.001
"""Fraction of the reachable states that may be called unreachable: one beside an edge, two cells from it."""
MEDIAN = 0.05
"""Median error that a solution may have without a doubt of its own."""


def against_referee(random: np.random.Generator, _folder: Path) -> None:
    """Hold the solution of one system to its reference, and its certificate to its error."""
    verdict = try_seed(int(random.integers(SEEDS)))
    said = f"{describe(verdict)}\nagain: python test/referee --only {verdict.seed}"
    assert not verdict.fault, said
    assert verdict.lost <= max(1.0, LOST * verdict.reachable), said
    assert not verdict.median > MEDIAN or verdict.doubts, said


ATTACKS = (
    Attack(
        "values-referee",
        "Random systems: no reachable state is called unreachable; times are right, or the solution doubts them.",
        against_referee,
        limit_s=600.0,
    ),
)
