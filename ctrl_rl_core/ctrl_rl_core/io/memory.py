"""Memory that can be allocated."""

from __future__ import annotations

from pathlib import Path


def available() -> float:
    """Return the bytes that can be allocated: those of the system, or fewer where this process's group is limited."""
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
