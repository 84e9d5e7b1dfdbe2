"""Outcomes of the steps near target and obstacles, computed on a GPU or by the same kernel on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ttr_reward_node.kernels.boundary_conditions import BoundaryConditions, Paths
from ttr_reward_node.kernels.stencil import Grid
from ttr_reward_node.kernels.warp_outcomes import Boundary, find_outcomes

BLOCK = 1 << 24
"""Number of outcomes computed at once: about 100 MB of device memory."""


class OutcomeFinder:
    """Function that fills in outcomes, with the arguments of `kernels.boundary_conditions.find_outcomes`.

    Args:
        device: Name of the Warp device.
    """

    def __init__(self, device: str) -> None:
        self._device = device

    def __call__(
        self,
        nodes: NDArray[np.int64],
        slabs: NDArray[np.int64],
        paths: Paths,
        grid: Grid,
        is_long: NDArray[np.bool_],
        boundary: BoundaryConditions,
        rate: float,
        outcomes: NDArray[np.float32],
    ) -> None:
        """Fill `outcomes` (N, pairs) of nodes (N,)."""
        found = wp.empty(outcomes.shape, dtype=float, device=self._device)
        ways = [self._put(array) for array in (paths.durations, paths.moves, paths.ahead, paths.more, paths.reach)]
        given = [self._put(nodes, np.int32), self._put(slabs, np.int32), *ways, self._put(is_long, np.uint8)]
        conditions = self._boundary(grid, boundary, rate)
        wp.launch(find_outcomes, outcomes.shape, inputs=[*given, conditions, found], device=self._device)
        outcomes[:] = found.numpy()

    def _boundary(self, grid: Grid, given: BoundaryConditions, rate: float) -> Any:
        boundary, n = Boundary(), int(grid["n"])
        boundary.box, boundary.disc = self._put(given.box[:n]), self._put(given.disc)
        boundary.disc_axes = self._put(given.disc_axes, np.int32)
        boundary.clearance = self._put(given.clearance)
        boundary.clearance_axes = self._put(given.clearance_axes, np.int32)
        boundary.cell, boundary.rate = given.cell, rate
        boundary.counts, boundary.strides, boundary.periodic = (
            self._put(grid[name][:n], np.int32) for name in ("counts", "strides", "periodic")
        )
        return boundary

    def _put(self, array: NDArray[Any], dtype: Any = None) -> Any:
        return wp.array(np.ascontiguousarray(array, dtype=dtype), device=self._device)
