"""Arrays of the safety solver: values with ghost nodes around them, and the steps of all blocks, tabulated once."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.kernels.safety_stencil import SafetyTables
from ttr_reward_node.problems.safety import SafetyGame
from ttr_reward_node.solvers.solution import require_memory
from ttr_reward_node.solvers.steps import make_layout, slab_states

_BLOCK = 1 << 16  # number of steps computed at once
_CELLS = 2.0  # displacement of the fastest axis per step, on average over the grid [cells]
Array = NDArray[np.float32]


class GhostedGrid:
    """Memory layout of a game's grid: outer axes, then inner ones, each with ghosts below and above.

    Args:
        game: Game with the system and the axes.
        moves: Displacements of all steps (blocks, pairs, n) [cells], axes in the layout's order.
        width: Nodes of a stencil along each axis, 2 or 4.
    """

    def __init__(self, game: SafetyGame, moves: NDArray[np.float64], width: int) -> None:
        layout = make_layout(game)
        self.order = layout.order
        self.n_outer = len(layout.outer)
        self.grid_shape = tuple(axis.count for axis in game.axes)
        axes = [game.axes[k] for k in self.order]
        self.counts = [axis.count for axis in axes]
        self.periodic = [axis.periodic for axis in axes]
        below, above = width // 2 - 1, width // 2
        cells = np.floor(moves)
        self.ghosts = [
            (below, above)
            if k < self.n_outer
            else (below + max(0, -int(cells[..., k].min())), above + max(0, int(cells[..., k].max())))
            for k in range(len(axes))
        ]
        self.shape = tuple(c + sum(g) for c, g in zip(self.counts, self.ghosts, strict=True))
        self.block_size = math.prod(self.shape[self.n_outer :])

    @property
    def strides(self) -> NDArray[np.int64]:
        """Distance between neighbours along each axis, in the layout's order (n,)."""
        return np.array([math.prod(self.shape[k + 1 :]) for k in range(len(self.shape))], dtype=np.int64)

    def with_ghosts(self, values: NDArray[Any]) -> Array:
        """Return values (grid shape) as a flat array with ghosts."""
        out = np.asarray(values, dtype=np.float32).transpose(self.order)
        for k in range(len(self.shape)):
            out = out.take(self._sources(k), axis=k)
        return np.ascontiguousarray(out).ravel()

    def without_ghosts(self, values: Array) -> Array:
        """Return the values (grid shape) of a flat array with ghosts."""
        core = tuple(slice(g[0], g[0] + c) for g, c in zip(self.ghosts, self.counts, strict=True))
        return np.ascontiguousarray(values.reshape(self.shape)[core].transpose(np.argsort(self.order)))

    def fill_outer_ghosts(self, values: Array) -> None:
        """Copy edges, or the opposite ends along periodic axes, into the ghosts of the outer axes."""
        shaped = values.reshape(self.shape)
        for k in range(self.n_outer):
            sources = self._sources(k)
            low, count = self.ghosts[k][0], self.counts[k]
            line = np.moveaxis(shaped, k, 0)
            for ghost in (*range(low), *range(low + count, self.shape[k])):
                line[ghost] = line[low + sources[ghost]]

    def as_blocks(self, name: str, values: Any) -> Array:
        """Return a margin (broadcast to the grid) as blocks with ghosts; a single block if all are equal.

        Raises:
            TimeToReachError: The margin has another shape, or is not finite.
        """
        given, n = np.asarray(values, dtype=np.float32), len(self.shape)
        given = given.reshape((1,) * (n - given.ndim) + given.shape) if given.ndim < n else given
        if given.ndim > n or any(a not in (1, b) for a, b in zip(given.shape, self.grid_shape, strict=True)):
            raise TimeToReachError(
                f"{name} has shape {np.shape(values)}: give one that broadcasts to {self.grid_shape}"
            )
        if not np.isfinite(given).all():
            raise TimeToReachError(f"{name} is NaN or infinite somewhere: give distances, a large one for none")
        given = given.transpose(self.order)
        alike = given.shape[: self.n_outer] == (1,) * self.n_outer
        outer = given.shape[: self.n_outer] if alike else self.counts[: self.n_outer]
        out = np.broadcast_to(given, (*outer, *self.counts[self.n_outer :]))
        for k in range(self.n_outer, n):
            out = out.take(self._sources(k), axis=k)
        return np.ascontiguousarray(out).reshape(-1, self.block_size)

    def _sources(self, k: int) -> NDArray[np.int64]:
        """Return, for each node and ghost along axis k, the index of the node that it copies."""
        at = np.arange(-self.ghosts[k][0], self.counts[k] + self.ghosts[k][1])
        return at % self.counts[k] if self.periodic[k] else np.clip(at, 0, self.counts[k] - 1)


def usual_step(game: SafetyGame) -> float:
    """Return a time step in which the fastest axis moves two cells, on average over the grid [s].

    Raises:
        TimeToReachError: Nothing moves.
    """
    rates = np.abs(_tabulate(game, 0.0))
    cells = rates.max(axis=(1, 2)).mean()
    if not cells > 0.0:
        raise TimeToReachError(f"{game.system.name}: nothing moves on this grid, so that there is nothing to solve")
    return float(_CELLS / cells)


def make_tables(game: SafetyGame, step: float, width: int) -> tuple[GhostedGrid, SafetyTables]:
    """Tabulate steps of duration `step` [s] for stencils of `width` nodes along each axis."""
    moves = _tabulate(game, step)
    grid = GhostedGrid(game, moves, width)
    n_outer, n = grid.n_outer, len(grid.shape)
    blocks, n_pairs = moves.shape[:2]
    pattern_axes = n - 1 if n_outer == n else n_outer  # without inner axes, stencils are contiguous along the last axis
    strides = grid.strides
    cells, parts = np.zeros(moves.shape, np.int64), np.zeros(moves.shape, np.float32)
    index = np.stack(np.unravel_index(np.arange(blocks), grid.counts[:n_outer]), axis=-1) if n_outer else None
    corners, places = np.zeros((blocks, n_pairs), np.int64), np.zeros(blocks, np.int64)
    for k in range(n):
        at = moves[..., k]
        if k < n_outer:
            assert index is not None
            at = at + index[:, None, k]
            at = at if grid.periodic[k] else np.clip(at, 0.0, grid.counts[k] - 1.0)
        below = np.floor(at)
        if k < n_outer and not grid.periodic[k]:
            below = np.minimum(below, grid.counts[k] - 2.0)
        parts[..., k] = at - below
        cells[..., k] = below % grid.counts[k] if k < n_outer and grid.periodic[k] else below
        if k < n_outer:
            assert index is not None
            corners += cells[..., k] * strides[k]
            places += (index[:, k] + grid.ghosts[k][0]) * strides[k]
    pattern = np.zeros(1, np.int64)
    for k in range(pattern_axes):
        pattern = (pattern[:, None] + np.arange(width) * strides[k]).ravel()
    inner = [(strides[k], grid.counts[k], *grid.ghosts[k], int(grid.periodic[k])) for k in range(n_outer, n)]
    return grid, SafetyTables(
        blocks=places,
        corners=corners,
        cells=np.ascontiguousarray(cells[..., n_outer:]),
        parts=parts,
        pattern=pattern,
        inner=np.array(inner, dtype=np.int64).reshape(-1, 5),
        disturbances=game.pairs()[2],
        width=width,
    )


def memory_needed(game: SafetyGame) -> float:
    """Return the peak memory of the tables, values and margins of a game [bytes]."""
    layout = make_layout(game)
    tables = layout.slabs * len(game.pairs()[0]) * (8.0 + 28.0 * len(game.axes))
    return tables + 40.0 * math.prod(axis.count for axis in game.axes) + 2e8  # 200 MB for compilation


def _tabulate(game: SafetyGame, step: float) -> NDArray[np.float64]:
    """Return displacements of the steps (blocks, pairs, n) [cells] in the layout's order; rates [1/s] for step 0."""
    require_memory(memory_needed(game), math.prod(axis.count for axis in game.axes))
    layout = make_layout(game)
    states, (u, d, _) = slab_states(game, layout), game.pairs()
    spacings = np.array([axis.spacing for axis in game.axes])
    moves = np.empty((len(states), len(u), len(spacings)))
    size = max(1, _BLOCK // len(u))
    for begin in range(0, len(states), size):
        x = states[begin : begin + size, None]
        change = game.system.step(x, u, d, dt=step) - x if step > 0.0 else game.system.dynamics(x, u, d)
        moves[begin : begin + size] = change / spacings
    return moves[..., layout.order]
