"""Check of the memory that a solution needs against the memory that is free."""

from __future__ import annotations

from ctrl_rl_core.io.file_checks import available_memory

from ttr_reward_node.errors import TimeToReachError


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
