"""Entry points of the kernels, with machine code cached on disk.

Numba's cache of a function is valid while the function's own file is unchanged; changes in its callees go unnoticed.
But closure variables are part of the cache key. So each entry point closes over a checksum of all kernels, and is
recompiled when one of them changes.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ctrl_rl_core.values import cached_njit

from ttr_reward_node.kernels import (
    boundary_conditions,
    lax_friedrichs_sweep,
    node_sweep,
    safety_sweep,
    slab_sweep,
    sweep,
)

KERNEL_FILES = (
    "stencil.py",
    "row_interpolation.py",
    "boundary_conditions.py",
    "sweep.py",
    "node_sweep.py",
    "slab_stencil.py",
    "slab_interpolation.py",
    "slab_sweep.py",
    "lax_friedrichs_sweep.py",
    "safety_stencil.py",
    "safety_sweep.py",
)


class Kernels(NamedTuple):
    """Compiled entry points of the kernels."""

    find_outcomes: Callable[..., Any]
    sweep: Callable[..., Any]
    sweep_nodes: Callable[..., Any]
    sweep_slabs: Callable[..., Any]
    lax_friedrichs: Callable[..., Any]
    step_back: Callable[..., Any]


@cache
def kernels() -> Kernels:
    """Return the entry points; each is compiled, or loaded from the cache, at its first call."""
    checksum = 0
    for name in KERNEL_FILES:
        checksum = zlib.crc32((Path(__file__).parent / name).read_bytes(), checksum)
    return _make(checksum)


def _make(checksum: int) -> Kernels:
    def find_outcomes(*arguments: Any) -> Any:
        assert checksum >= 0
        return boundary_conditions.find_outcomes(*arguments)

    def semi_lagrangian(*arguments: Any) -> Any:
        assert checksum >= 0
        return sweep.sweep(*arguments)

    def sweep_nodes(*arguments: Any) -> Any:
        assert checksum >= 0
        return node_sweep.sweep_nodes(*arguments)

    def sweep_slabs(*arguments: Any) -> Any:
        assert checksum >= 0
        return slab_sweep.sweep_slabs(*arguments)

    def lax_friedrichs(*arguments: Any) -> Any:
        assert checksum >= 0
        return lax_friedrichs_sweep.sweep(*arguments)

    def step_back(*arguments: Any) -> Any:
        assert checksum >= 0
        return safety_sweep.step_back(*arguments)

    entries = (find_outcomes, semi_lagrangian, sweep_nodes, sweep_slabs, lax_friedrichs, step_back)
    # Release the GIL so that threads can share a sweep.
    return Kernels(*(cached_njit(entry, error_model="numpy", nogil=True) for entry in entries))
