"""Sweeps on a GPU, or by the same kernels on the CPU, with the interface of `solvers.sweeper`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import NEAR
from ttr_reward_node.kernels.stencil import Grid, StepTable
from ttr_reward_node.kernels.sweep import SweepSettings
from ttr_reward_node.kernels.warp_interpolation import Rule, Table
from ttr_reward_node.kernels.warp_sweep import sweep_kernels
from ttr_reward_node.solvers.near_nodes import NearNodes
from ttr_reward_node.solvers.sweeper import cheapened, mark_lost

# Updates of each node per sweep: the first tries all pairs, the others only the best of these, as in policy iteration,
# at a fraction of the cost. Changes propagate one step per update.
_UPDATES = 5
_TURNS = 2  # passes until all nodes have been updated once


class WarpSweeper:
    """Sweeper whose values and tables stay in device memory; results are identical in every run.

    Args:
        device: Name of the Warp device, e.g. "cuda:0" or "cpu".
        grid: Axes in the layout's order.
        table: Steps of the slabs.
        near: Nodes near target and obstacles, and outcomes of their steps.
    """

    def __init__(self, device: str, grid: Grid, table: StepTable, near: NearNodes) -> None:
        n, n_outer = int(grid["n"]), int(grid["n_outer"])
        self._device, self._kernels = device, sweep_kernels(n, n_outer)
        self._inner = math.prod(int(count) for count in grid["counts"][n_outer:n])
        self._rows = n_outer < n
        slabs = len(table.codes)
        self._host, self._host_is_newer, self._device_is_newer = near.values, False, False
        self._values, self._news = self._put(near.values), wp.empty(near.values.size, dtype=float, device=device)
        self._flags, self._host_flags = self._put(near.flags), near.flags
        # Same order as `near.outcomes`: no near node is marked unreachable before the first phase ends.
        self._near = self._put(np.flatnonzero(near.flags == NEAR).astype(np.int32))
        self._outcomes, self._host_outcomes = self._put(near.outcomes), near.outcomes
        self._table, self._shape = Table(), self._kernels.shape()
        self._table.codes, self._table.ends = self._put(table.codes), self._put(table.ends)
        self._table.ranges = self._put(table.ranges if self._rows else np.zeros((1, 1, 1, 2), np.int8))
        self._long = table.long
        self.admit_long(False)
        self._table.discounts, self._host_discounts = self._put(table.discounts), table.discounts
        self._controls, self._game = table.controls, table.controls < table.codes.shape[1]
        self._choices = wp.zeros(near.values.size, dtype=wp.uint16, device=device)
        for name in ("counts", "strides", "periodic"):
            setattr(self._shape, name, [int(number) for number in grid[name][:n]])
        tracked = slabs if self._rows else 1
        self._active = wp.zeros(tracked, dtype=wp.uint8, device=device)
        self._changed, self._seen = (wp.zeros(tracked, dtype=int, device=device) for _ in range(2))
        self._changes = wp.zeros(_UPDATES * _TURNS, dtype=float, device=device)
        self._passes = 0

    @property
    def values(self) -> NDArray[np.float32]:
        """Values w at the nodes; may be changed before the next sweep."""
        if self._device_is_newer:
            self._host[:] = self._values.numpy()
        self._host_is_newer, self._device_is_newer = True, False
        return self._host

    def sweep(self, settings: SweepSettings, in_phase: int) -> float:
        """Update every node that may change several times; return an upper bound of the largest change [s]."""
        del in_phase
        if self._host_is_newer:
            wp.copy(self._values, wp.array(self._host, dtype=float, device="cpu", copy=False))
        self._host_is_newer, self._device_is_newer = False, True
        rule = self._rule(settings)
        self._changes.zero_()
        for turn in range(_UPDATES * _TURNS):
            self._passes += 1
            rule.number, rule.slot = self._passes, turn
            rule.full = int(turn < _TURNS or self._game)  # in a game, the best control differs for each disturbance
            self._pass(rule)
        return float(self._changes.numpy().sum()) / settings.rate

    def restart(self, lost: NDArray[np.bool_] | None = None) -> None:
        """Reset the history; the next sweeps leave `lost` nodes unchanged."""
        self._seen.zero_()
        mark_lost(self._host_flags, lost)
        self._flags = self._put(self._host_flags)

    def admit_long(self, admitted: bool) -> None:
        """Choose whether long steps may end beside unreachable nodes, as short ones may."""
        self._table.is_long = self._put((self._long & (not admitted)).astype(np.uint8))

    def cheapen(self, power: float) -> None:
        """Multiply the rate of the transform; done on the host, at most once."""
        self.values[:] **= np.float32(power)
        self._kept = cheapened(self._host_discounts, self._host_outcomes, power)
        self._table.discounts, self._outcomes = self._put(self._host_discounts), self._put(self._host_outcomes)

    def restore(self) -> None:
        """Undo the effect of `cheapen` on the steps."""
        self._host_discounts[:], self._host_outcomes[:] = self._kept
        self._table.discounts, self._outcomes = self._put(self._host_discounts), self._put(self._host_outcomes)

    def _rule(self, settings: SweepSettings) -> Any:
        rule = Rule()
        rule.jump, rule.enough = settings.jump * settings.rate, settings.enough
        rule.quiet, rule.curved = settings.quiet * settings.rate, int(settings.curved)
        rule.first, rule.controls, rule.inner = int(math.isinf(settings.jump)), self._controls, self._inner
        return rule

    def _pass(self, rule: Any) -> None:
        if self._rows:
            chosen = [self._table, self._shape, rule, self._changed, self._seen, self._active]
            wp.launch(self._kernels.awaken, len(self._seen), inputs=chosen, device=self._device)
        for near, size in ((0, len(self._flags)), (1, len(self._near))):
            rule.near = near
            arrays = [self._values, self._news, self._flags, self._near, self._outcomes]
            history = [self._choices, self._active, self._changed, self._changes]
            if size:
                inputs = [*arrays, self._table, self._shape, rule, *history]
                wp.launch(self._kernels.sweep, size, inputs=inputs, device=self._device)
        self._values, self._news = self._news, self._values

    def _put(self, array: NDArray[Any]) -> Any:
        return wp.array(np.ascontiguousarray(array), device=self._device)


def free_memory(device: str) -> float:
    """Return the free memory of a GPU [bytes]; infinite for the CPU, which `solution.require_memory` checks."""
    found = wp.get_device(device)
    return float(found.free_memory) if found.is_cuda else math.inf
