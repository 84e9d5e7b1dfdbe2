"""Results of the solvers, and a check of their memory."""

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
    """Result of a method: phi (grid shape) [s], +inf if unreachable; number of sweeps; last change [s]; convergence."""

    phi: NDArray[np.float32]
    number: int
    residual: float
    converged: bool


@dataclass(frozen=True, eq=False)
class Solution:
    """Time-to-reach function and details of the solution.

    Attributes:
        grid: Time-to-reach function; +inf where the target cannot be reached.
        sweeps: Number of sweeps.
        residual: Largest change of phi in the last sweep [s]; inf if nodes still became reachable.
        converged: Whether the residual is within the tolerance.
        cpu_seconds: Processor time [s], excluding compilation if the kernels are cached.
        reachable: Fraction of the nodes that can reach the target.
        memory: Memory estimate made before solving [bytes].
        certificate: Results of drives and backward paths, and doubts; None if not requested.
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
    """Check that a problem fits into memory.

    Raises:
        TimeToReachError: More memory is needed than is free; both amounts are named.
    """
    there = available_memory()
    if needed > there:
        raise TimeToReachError(
            f"{points:,} grid points need {gigabytes(needed)} of memory, {gigabytes(there)} are free: "
            "take fewer points on some axes (counts), or split the system (decomposition)"
        )


def gigabytes(bytes_: float) -> str:
    """Format a size in GB."""
    return f"{bytes_ / 1e9:.2f} GB"
