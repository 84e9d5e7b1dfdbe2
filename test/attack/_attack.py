"""What an attack is: a promise, and a round that tries to break it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Attack:
    """One promise and the round that tries to break it.

    Attributes:
        name: the name on the command line, `files-json`.
        promise: the sentence that a fault would refute.
        run: one round: takes a seeded generator and an empty folder, and raises AssertionError where the promise is
            broken. Everything random comes from the generator, so that a seed brings a fault about again.
        limit_s: the longest that a round may take before it counts as a hang [s].
        memory: the address space that a round may take [bytes]; None for no limit.
        repeats: whether a further round with another seed tries something new.
    """

    name: str
    promise: str
    run: Callable[[np.random.Generator, Path], None]
    limit_s: float = 120.0
    memory: int | None = None
    repeats: bool = True
