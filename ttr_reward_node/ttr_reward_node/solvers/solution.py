"""What a solver returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.values.value_grid import ValueGrid
from numpy.typing import NDArray

Progress = Callable[[int, float], None]
"""Called after each sweep with its number and the largest change of phi [s]."""


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Outcome of a method: phi (grid shape) [s], +inf where unreachable; sweeps; last change [s]; whether small."""

    phi: NDArray[np.float32]
    number: int
    residual: float
    converged: bool


@dataclass(frozen=True, eq=False)
class Solution:
    """A time-to-reach function and how it was found.

    Attributes:
        grid: the function; +inf where the target cannot be reached.
        sweeps: how many sweeps it took.
        residual: largest change of phi in the last sweep [s]; inf where nodes still became reachable.
        converged: whether the residual is within the tolerance.
        cpu_seconds: processor time, without compilation where the kernels were compiled before.
        reachable: fraction of the nodes from which the target can be reached.
        memory: bytes that the solver stated beforehand.
    """

    grid: ValueGrid
    sweeps: int
    residual: float
    converged: bool
    cpu_seconds: float
    reachable: float
    memory: float
