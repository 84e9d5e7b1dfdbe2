"""Motion of a system under a constant control until it has moved a given number of cells.

The semi-Lagrangian scheme fixes the length of a step on the grid, not its duration: a slow state gets as much time as
it needs. So the accuracy of a step does not depend on how much faster the system moves elsewhere.

A block holds k states under p pairs, so m = k p steps, with the pair as the fastest-varying index.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import System
from ttr_reward_node.kernels.held_steps import (
    DONE,
    LOST,
    Starts,
    correct_durations,
    finish_step,
    fourth_stage,
    go_half,
    guess_durations,
    improve_durations,
    onto_planes,
    third_stage,
)
from ttr_reward_node.kernels.step_tables import Paths

Array = NDArray[np.float64]

_ROOM_OF_DISTURBANCE = 0.5  # displacement by disturbances up to which a slow pair may continue, per step length
_HALVINGS = 40  # maximum number; a step that is still not smooth gets the duration 0
_CORRECTIONS = 2  # number of corrections of the durations of steps that end far from their plane


class HeldPairs(NamedTuple):
    """Controls and disturbances held constant during a step.

    Attributes:
        u: Controls (pairs, m).
        d: Disturbances (pairs, n).
    """

    u: Array
    d: Array


class Derivatives:
    """Derivatives of a system under each pair, for arrays with one row per state component."""

    def __init__(self, system: System, pairs: HeldPairs) -> None:
        self.pairs = pairs
        self._rates = system.equations(np, system.parameters)
        self._u, self._d = (tuple(np.ascontiguousarray(each.T)) for each in pairs)

    def of(self, states: Array, spacings: Array) -> Array:
        """Return initial rates (n, k p) [cells/s] at states (k, n), NaN or infinite if the derivatives are."""
        out = np.empty((states.shape[1], len(states), len(self.pairs.u)))
        with np.errstate(all="ignore"):
            self._evaluate(tuple(states.T[..., None]), self._u, self._d, out)
            out /= spacings[:, None, None]
        return out.reshape(len(out), -1)

    def fill(self, x: Array, out: Array, columns: NDArray[np.int64] | None = None) -> Array:
        """Set `out` (n, m) to the derivatives, per second, at states x (n, m) and return it.

        Args:
            x: One state for each step.
            out: Output.
            columns: Pair of each step (m,); default: the pair varies fastest.
        """
        if columns is None:
            shape = len(x), -1, len(self.pairs.u)
            self._evaluate(tuple(x.reshape(shape)), self._u, self._d, out.reshape(shape))
        else:
            u, d = (tuple(row[columns] for row in rows) for rows in (self._u, self._d))
            self._evaluate(tuple(x), u, d, out)
        return out

    def _evaluate(self, x: tuple[Array, ...], u: tuple[Array, ...], d: tuple[Array, ...], out: Array) -> None:
        for row, rate in zip(out, self._rates(x, u, d), strict=True):
            row[...] = rate


class Block:
    """Steps of k states under all pairs of some derivatives, and the memory to compute them."""

    def __init__(self, derivatives: Derivatives, states: Array, spacings: Array, limits: Array | None = None) -> None:
        """Initialise.

        Args:
            derivatives: Derivatives of the system.
            states: Start states (k, n).
            spacings: Spacing of each axis (n,), in its unit.
            limits: Lowest and highest state (2, n) at which a step is truncated; default: none.
        """
        pairs = len(derivatives.pairs.u)
        self._derivatives = derivatives
        low, high = (-np.inf, np.inf) if limits is None else limits[..., None]
        x = states.T
        below, above = (x - low) / spacings[:, None], (high - x) / spacings[:, None]
        first = derivatives.of(states, spacings)
        longest = np.full(first.shape[1], np.inf)
        x, below, above = (np.repeat(each, pairs, axis=1) for each in (x, below, above))
        self.starts = Starts(x, below, above, first, longest, spacings)
        self._stage, self._second, self._third, self._move = np.empty((4, *first.shape))
        self._h, self._bent, self._work = np.empty((3, first.shape[1]))
        self._state = np.empty(first.shape[1], np.uint8)

    @property
    def ends(self) -> Array:
        """States (k, p, n) at the end of the last steps."""
        return np.moveaxis(self._stage.reshape(len(self._stage), -1, len(self._derivatives.pairs.u)), 0, -1)

    def move_cells(self, cells: float, longest: Array | None = None) -> Paths:
        """Return the paths of the states until they have moved `cells` along their fastest axis, or to a limit.

        A step is also shortened if a fourth-order Runge-Kutta step would be inaccurate, e.g. on a circle smaller than a
        cell. The paths stay valid until the block's next call.

        Args:
            cells: Length of the steps [cells].
            longest: Maximum durations (m,) [s].
        """
        self.starts.longest[:] = np.inf if longest is None else longest
        starts, stage, h, work = self.starts, self._stage, self._h, self._work
        with np.errstate(all="ignore"):  # a trial step may end where the equations are undefined
            guess_durations(starts, cells, h, stage)
            # The rate at the midpoint gives a good initial guess of the duration.
            half = self._derivatives.fill(stage, self._second)
            half /= starts.spacings[:, None]
            improve_durations(starts, half, cells, h, stage, work)
            self._runge_kutta(cells)
            if self._state.any():
                self._correct(cells)
            last = self._final_rates()
        onto_planes(starts, cells, last, h, self._move, work, self._bent)
        return Paths(h, self._move, starts.first, last)

    def move_for(self, durations: Array) -> Paths:
        """Return the paths for given durations (m,) [s]; valid until the block's next call."""
        starts = self.starts
        self._h[:] = durations
        go_half(starts.x, starts.first, starts.spacings, self._h, self._stage)
        with np.errstate(all="ignore"):
            self._runge_kutta(1.0)
            return Paths(self._h, self._move, starts.first, self._final_rates())

    def patience(self, cells: float, patience: float, controls: int) -> Array:
        """Return maximum durations (m,) [s] of steps against a disturbance.

        Knowing how long the opponent holds its input is an advantage: as much as the opponent could do in that time.

        Args:
            cells: Length of the steps [cells].
            patience: Maximum duration as a multiple of that of the state's fastest pair, unless the disturbances have
                little effect in that time.
            controls: Number of controls; the control is the fastest-varying index of the pairs.
        """
        first, pairs = self.starts.first, len(self._derivatives.pairs.u)
        fastest = np.abs(first).max(axis=0)
        moving = np.isfinite(fastest) & (fastest > 0.0)
        finite = np.where(moving, first, 0.0).reshape(len(first), -1, pairs // controls, controls)
        spread = np.ptp(finite, axis=2).max(axis=(0, -1))
        quickest = np.where(moving, fastest, 0.0).reshape(-1, pairs).max(axis=1)
        with np.errstate(divide="ignore"):
            longest = cells * np.maximum(patience / quickest, _ROOM_OF_DISTURBANCE / spread)
        return np.repeat(longest, pairs)

    def _runge_kutta(self, cells: float) -> None:
        """Do one classical Runge-Kutta step from the second stage on."""
        work = self._second, self._third, self._stage, self._h, self._bent, self._move, self._state, self._work
        _runge_kutta(self._derivatives, self.starts, cells, work)

    def _final_rates(self) -> Array:
        last = self._derivatives.fill(self._stage, self._third)
        last /= self.starts.spacings[:, None]
        return last

    def _correct(self, cells: float) -> None:
        """Correct steps that end far from their plane or are inaccurate; set those that stay inaccurate to 0."""
        pairs = len(self._derivatives.pairs.u)
        at = np.flatnonzero(self._state != DONE)
        for turn in range(_HALVINGS):
            names = "x", "below", "above", "first", "longest"
            # np.take keeps the order in memory for which the kernels are compiled; an index would transpose it.
            starts = self.starts._replace(**{name: np.take(getattr(self.starts, name), at, axis=-1) for name in names})
            h, move, state = self._h[at], np.take(self._move, at, axis=1), self._state[at]
            second, third, stage = np.empty((3, *move.shape))
            bent, work = np.empty((2, len(at)))
            correct_durations(starts, move, cells, state, h, stage, work)
            arrays = second, third, stage, h, bent, move, state, work
            _runge_kutta(self._derivatives, starts, cells, arrays, at % pairs)
            self._h[at], self._move[:, at], self._stage[:, at] = h, move, stage
            self._state[at], self.starts.longest[at] = state, starts.longest
            lost = state == LOST
            at = at[lost | (turn < _CORRECTIONS)]
            if len(at) == 0:
                return
        self._h[at], self._move[:, at], self._stage[:, at] = 0.0, 0.0, self.starts.x[:, at]


def _runge_kutta(
    derivatives: Derivatives,
    starts: Starts,
    cells: float,
    work: tuple[Any, ...],
    columns: NDArray[np.int64] | None = None,
) -> None:
    """Do a Runge-Kutta step of some steps, with the pair of each in `columns` (m,); arrays as in `Block`."""
    second, third, stage, h, bent, move, state, scratch = work
    derivatives.fill(stage, second, columns)
    third_stage(starts.x, second, h, stage)
    derivatives.fill(stage, third, columns)
    fourth_stage(starts.x, second, third, starts.spacings, h, stage, bent)
    derivatives.fill(stage, third, columns)
    finish_step(starts, second, third, cells, h, bent, move, stage, state, scratch)
