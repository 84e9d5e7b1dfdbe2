"""Sweeps over the nodes in parts, by the kernel for the layout: rows with equal steps, slabs, or single nodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import FIXED, LOST
from ttr_reward_node.kernels.entry_points import kernels
from ttr_reward_node.kernels.slab_sweep import SlabHistory
from ttr_reward_node.kernels.stencil import Grid, StepTable
from ttr_reward_node.kernels.sweep import Nodes, RowHistory, SweepSettings
from ttr_reward_node.solvers.near_nodes import NearNodes
from ttr_reward_node.solvers.steps import SMALL, Layout
from ttr_reward_node.solvers.threads import share

_LARGE = SMALL, 1_000_000  # number of nodes above which two threads pay off, with steps per node or shared by a row
_THICK = 8  # minimum nodes along the first axis in each part, since values across the border are one sweep old
_SHORT = 48  # maximum number of nodes in a row for sweeps by slab; longer rows justify their own stencils
_FULL_EVERY = 3  # period of the sweeps over single nodes that try all steps


class Sweeper(Protocol):
    """Values of the nodes, and sweeps that bring them closer to the solution."""

    @property
    def values(self) -> NDArray[np.float32]:
        """Values w at the nodes, flat in the layout's order; may be read and changed between two sweeps."""

    def sweep(self, settings: SweepSettings, in_phase: int) -> float:
        """Do sweep number `in_phase` of a phase; return the largest change [s], NaN if it does not show convergence."""

    def restart(self, lost: NDArray[np.bool_] | None = None) -> None:
        """Reset the history because the settings change; the next sweeps leave `lost` nodes unchanged."""

    def admit_long(self, admitted: bool) -> None:
        """Choose whether long steps may end beside unreachable nodes, as short ones may."""

    def cheapen(self, power: float) -> None:
        """Multiply the rate of the transform: raise w at the nodes and the discounts of the steps to a power."""

    def restore(self) -> None:
        """Undo the effect of `cheapen` on the steps exactly; w at the nodes stays."""


def make_sweeper(layout: Layout, grid: Grid, table: StepTable, near: NearNodes) -> Sweeper:
    """Return the sweeper for a layout: without inner axes, no two nodes share their steps."""
    thick = len(layout.order) > 1 and bool(layout.outer) and int(layout.counts[0]) >= 2 * _THICK
    parts = 2 if near.flags.size >= _LARGE[1 if layout.inner else 0] and thick else 1
    if not layout.inner:
        return _NodeSweeper(grid, table, near, parts)
    return (_SlabSweeper if _has_short_rows(layout) else _RowSweeper)(grid, table, near, parts)


def _has_short_rows(layout: Layout) -> bool:
    """Whether rows are short enough to sweep whole slabs, with two or more inner axes and no step that wraps around."""
    first = len(layout.outer)
    flat_ = len(layout.inner) > 1 and not layout.periodic[first:].any()
    return flat_ and len(layout.outer) > 1 and int(layout.counts[-1]) <= _SHORT


class _Sweeper:
    """Common part of the sweepers: the nodes, and the steps between them.

    With two parts, each reads the other's values from before the sweep, regardless of thread timing: the second half of
    the arrays in `_doubled` is a copy of the first.
    """

    def __init__(self, grid: Grid, table: StepTable, near: NearNodes, parts: int) -> None:
        self._grid, self._table, self._parts = grid, table, parts
        self._nodes = Nodes(np.tile(near.values, parts), near.flags, near.outcomes, near.before_row)
        self.values: NDArray[np.float32] = self._nodes.values[: near.values.size]
        self._doubled: list[NDArray[Any]] = [self._nodes.values]
        self._long = table.long.copy()

    def _in_parts(self, kernel: Callable[[int, int], float]) -> float:
        """Return the largest change [s] over the parts, each swept by `kernel(part, parts)`."""
        if self._parts > 1:
            for both in self._doubled:
                both[len(both) // 2 :] = both[: len(both) // 2]
        return float(max(share(kernel, self._parts)))

    def admit_long(self, admitted: bool) -> None:
        self._table.long[:] = self._long & (not admitted)

    def cheapen(self, power: float) -> None:
        self.values **= np.float32(power)
        self._kept = cheapened(self._table.discounts, self._nodes.outcomes, power)

    def restore(self) -> None:
        self._table.discounts[:], self._nodes.outcomes[:] = self._kept


def mark_lost(flags: NDArray[np.uint8], lost: NDArray[np.bool_] | None) -> None:
    """Mark the given nodes (nodes,) as unreachable, and no others."""
    flags &= ~np.uint8(LOST)
    if lost is not None:
        flags[lost] |= LOST


def cheapened(
    discounts: NDArray[np.float32], outcomes: NDArray[np.float32], power: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Raise the discounts of steps and in outcomes to a power in place; return the original arrays."""
    kept = discounts.copy(), outcomes.copy()  # a root in single precision near 1 cannot be undone by a power
    discounts **= np.float32(power)
    np.power(outcomes, np.float32(power), out=outcomes, where=outcomes > 0.0)
    return kept


class _RowSweeper(_Sweeper):
    def __init__(self, grid: Grid, table: StepTable, near: NearNodes, parts: int) -> None:
        super().__init__(grid, table, near, parts)
        rows = len(near.before_row) - 1
        self._history = RowHistory(
            np.zeros(rows, np.int64),
            np.zeros(rows, np.int64),
            np.zeros(parts, np.int64),
            np.zeros(parts * rows, np.int64),
        )
        self._doubled.append(self._history.changed_in)

    def sweep(self, settings: SweepSettings, in_phase: int) -> float:
        del in_phase
        given = self._nodes, self._grid, self._table, self._history, settings
        return self._in_parts(lambda part, parts: kernels().sweep(*given, part, parts)[0])

    def restart(self, lost: NDArray[np.bool_] | None = None) -> None:
        self._history.seen[:] = 0
        mark_lost(self._nodes.flags, lost)


class _SlabSweeper(_Sweeper):
    def __init__(self, grid: Grid, table: StepTable, near: NearNodes, parts: int) -> None:
        super().__init__(grid, table, near, parts)
        self._slabs = slabs = len(table.codes)
        self._history = SlabHistory(
            np.zeros(slabs, np.int64),
            np.zeros(slabs, np.int64),
            np.zeros(parts, np.int64),
            np.zeros(parts * slabs, np.int32),
            np.zeros(parts * slabs, np.int32),
            np.zeros(slabs, np.int32),
        )
        self._doubled += [self._history.changed_in, self._history.reachable]
        self.restart()

    def sweep(self, settings: SweepSettings, in_phase: int) -> float:
        del in_phase
        given = self._nodes, self._grid, self._table, self._history, settings
        return self._in_parts(lambda part, parts: kernels().sweep_slabs(*given, part, parts)[0])

    def restart(self, lost: NDArray[np.bool_] | None = None) -> None:
        self._history.seen[:] = 0
        mark_lost(self._nodes.flags, lost)
        self._history.reachable[: self._slabs] = np.count_nonzero(self.values.reshape(self._slabs, -1), axis=1)
        closed = self._nodes.flags.reshape(self._slabs, -1) & (FIXED | LOST)
        self._history.open[:] = closed.shape[1] - np.count_nonzero(closed, axis=1)


class _NodeSweeper(_Sweeper):
    def __init__(self, grid: Grid, table: StepTable, near: NearNodes, parts: int) -> None:
        super().__init__(grid, table, near, parts)
        self._best = np.zeros(near.values.size, np.uint16)
        # In a game, the best step differs for each disturbance.
        self._every = _FULL_EVERY if table.codes.shape[1] == table.controls else 1

    def sweep(self, settings: SweepSettings, in_phase: int) -> float:
        full = in_phase % self._every == 0
        given = self._nodes, self._grid, self._table, self._best, settings, full
        change = self._in_parts(lambda part, parts: kernels().sweep_nodes(*given, part, parts))
        return change if full else math.nan

    def restart(self, lost: NDArray[np.bool_] | None = None) -> None:
        mark_lost(self._nodes.flags, lost)
