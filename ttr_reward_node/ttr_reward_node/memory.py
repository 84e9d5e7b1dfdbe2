"""How much memory a solution needs, and whether it is there."""

from __future__ import annotations

from pathlib import Path

from ttr_reward_node.errors import TimeToReachError


def available() -> float:
    """Bytes that can be allocated: what the system has to give, or less where this process's group may take less."""
    bytes_ = float("inf")
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                bytes_ = 1024.0 * float(line.split()[1])
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        if limit != "max":
            used = float(Path("/sys/fs/cgroup/memory.current").read_text(encoding="ascii"))
            bytes_ = min(bytes_, float(limit) - used)
    except (OSError, ValueError):
        pass  # not Linux, or no such group: nothing is known, nothing is refused
    return bytes_


def require(needed: float, points: int) -> None:
    """Refuse a problem that does not fit.

    Raises:
        TimeToReachError: says how much is needed and how much there is.
    """
    there = available()
    if needed > there:
        raise TimeToReachError(
            f"{points:,} grid points need {gigabytes(needed)} of memory, {gigabytes(there)} are free: "
            "take fewer points on some axes (counts), or split the system (decomposition)"
        )


def gigabytes(bytes_: float) -> str:
    """Return a size for people."""
    return f"{bytes_ / 1e9:.2f} GB"
