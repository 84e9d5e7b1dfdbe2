"""Results of the solvers, and the memory that they need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.io import available_memory
from numpy.typing import NDArray

from ctrl_rl_core import ValueGrid
from ttr_reward_node.certificates.certificate import Certificate
from ttr_reward_node.errors import TimeToReachError

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
        grid: Time-to-reach function; +inf where the target cannot be reached.
        sweeps: Number of sweeps until the solver stopped.
        residual: Largest change of phi in the last sweep [s]; inf where nodes still became reachable.
        converged: Whether the residual is within the tolerance.
        cpu_seconds: Processor time [s], without compilation where the kernels were compiled before.
        reachable: Fraction of the nodes from which the target can be reached.
        memory: Estimate of the memory that the solver made beforehand [bytes].
        certificate: Figures of drives and paths back, and doubts; None where it was not asked for.
    """

    grid: ValueGrid
    sweeps: int
    residual: float
    converged: bool
    cpu_seconds: float
    reachable: float
    memory: float
    certificate: Certificate | None = None


def require_memory(needed: float, points: int) -> None:
    """Refuse a problem that does not fit.

    Raises:
        TimeToReachError: More memory is needed than is free; both are named.
    """
    there = available_memory()
    if needed > there:
        raise TimeToReachError(
            f"{points:,} grid points need {gigabytes(needed)} of memory, {gigabytes(there)} are free: "
            "take fewer points on some axes (counts), or split the system (decomposition)"
        )


def gigabytes(bytes_: float) -> str:
    """Return a size as text, in GB."""
    return f"{bytes_ / 1e9:.2f} GB"
