"""Sets of states that can be kept safe against any bounded disturbance: viability kernels and tubes.

    solver = SafetySolver(SafetyGame(system, axes))
    solution = solver.solve(margin)                                 # safe for ever where solution.values >= 0
    solution = solver.solve(margin, horizon=2.0)                    # safe for two seconds
    solution = solver.solve(margin, target=inside, horizon=5.0)     # reaches the target safely within five seconds
    again = solver.solve(newer, initial=solver.shifted(solution.values, (1, 0, 0, 0), newer))

The margin l is the distance to the set to avoid, an array that broadcasts to the grid, negative inside the set. The
value is the smallest margin along the trajectory under optimal play by both sides (Mitchell, Bayen, Tomlin 2005; with a
target Fisac, Chen, Tomlin, Sastry 2015):

    avoid:        V(z, t) = max over u, min over d of   min over s of l(z(s), s)
    reach-avoid:  V(z, t) = max over u, min over d of   max over s of min{ r(z(s)), min over s' <= s of l(z(s'), s') }

The disturbance knows the control, so the value errs on the safe side. States that would leave the grid stay at its
edge: make the margin negative there if the region beyond is unsafe.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.kernels.entry_points import kernels
from ttr_reward_node.kernels.safety_sweep import Margins
from ttr_reward_node.problems.safety import SafetyGame
from ttr_reward_node.solvers.safety_tables import make_tables, usual_step
from ttr_reward_node.solvers.solution import Progress

INTERPOLATIONS = {"linear": 2, "cubic": 4}
"""Stencil width of each interpolation [nodes per axis]."""
_TOLERANCE = 1e-4  # relative to the range of the margin
_MOST_STEPS = 2000

Margin = ArrayLike | Callable[[float], ArrayLike]
"""Array that broadcasts to the grid, or a function of time [s] that returns one."""


@dataclass(frozen=True, eq=False)
class SafetySolution:
    """Safety value and details of the solution.

    Attributes:
        values: Value at the nodes (grid shape) [unit of the margin]; non-negative in the safe set.
        steps: Number of time steps back.
        change: Largest change of a node in the last step [unit of the margin].
        converged: Whether the change is within the tolerance, or the horizon has been reached.
        cpu_seconds: Processor time [s], excluding compilation if the kernels are cached.
    """

    values: NDArray[np.float32]
    steps: int
    change: float
    converged: bool
    cpu_seconds: float

    @property
    def safe(self) -> float:
        """Fraction of the nodes in the safe set."""
        return float(np.mean(self.values >= 0.0))


class SafetySolver:
    """Solves games that differ only in their margins; the steps are tabulated once.

    Args:
        game: System, axes and the sets of both players.
        step: Longest time step [s]; default: the fastest axis moves two cells per step, on average over the grid.
        interpolation: "cubic", or "linear", which is less accurate, faster, and monotone: a smaller margin or a larger
            disturbance then never increases a value, and the discounted form is a contraction.

    Raises:
        TimeToReachError: Unknown interpolation, a non-positive step, or too little memory.
    """

    def __init__(self, game: SafetyGame, *, step: float | None = None, interpolation: str = "cubic") -> None:
        if interpolation not in INTERPOLATIONS:
            raise TimeToReachError(
                f"unknown interpolation '{interpolation}'; choose one of {', '.join(INTERPOLATIONS)}"
            )
        if step is not None and not (math.isfinite(step) and step > 0.0):
            raise TimeToReachError(f"a time step of {step:g} s: it must be above 0")
        self.game = game
        self.step = usual_step(game) if step is None else step
        self._width = INTERPOLATIONS[interpolation]
        self._tabulated = 0.0
        self._tabulate(self.step)

    def solve(
        self,
        margin: Margin,
        *,
        target: Margin | None = None,
        horizon: float | None = None,
        initial: ArrayLike | None = None,
        discount: float = 0.0,
        tolerance: float | None = None,
        max_steps: int = _MOST_STEPS,
        progress: Progress | None = None,
    ) -> SafetySolution:
        """Compute the value.

        Args:
            margin: Margin l, non-negative where safe; a function of time for moving obstacles.
            target: Margin r, non-negative inside a target to reach; None for none.
            horizon: Duration of the game [s], divided into whole steps; None for an infinite horizon.
            initial: Initial values, e.g. of the last solution; default: the margins. From values that are nowhere too
                small, the iteration converges to the value itself. From smaller ones it may end at a smaller set, which
                is still safe, unless there is a discount.
            discount: Rate lambda [1/s] of the discounted form (Fisac et al. 2019), V = (1 - gamma) l + gamma min{l, V+}
                with gamma = exp(-lambda step): it converges to the same value from any initial values. That value is
                larger than the undiscounted one, by less the smaller lambda is.
            tolerance: Largest change at convergence [unit of the margin]; default: 1e-4 of the margin's range.
            max_steps: Maximum number of steps; beyond it the result is marked as not converged.
            progress: Function called after each step with its number and the largest change.

        Raises:
            TimeToReachError: An option or an array is invalid, or a margin moves without a horizon.
        """
        for name, given in (("horizon [s]", horizon), ("tolerance", tolerance), ("discount [1/s]", discount)):
            if given is not None and not (math.isfinite(given) and given >= 0.0):
                raise TimeToReachError(f"{name} is {given:g}: give a finite number that is not negative")
        if max_steps < 1:
            raise TimeToReachError(f"{max_steps} steps at most: allow 1 or more")
        moving = callable(margin) or callable(target)
        if moving and horizon is None:
            raise TimeToReachError("a margin that moves needs a horizon: give one in s")
        begin = time.process_time()
        number = max_steps if horizon is None else math.ceil(horizon / self.step - 1e-6)
        step = horizon / number if horizon else self.step
        self._tabulate(step)

        def at(back: int) -> tuple[ArrayLike, ArrayLike | None]:
            """Return margin and target `back` steps before the end."""
            moment = (number - back) * step
            return _at(margin, moment), None if target is None else _at(target, moment)

        margins = self._margins(*at(0), discount)
        tolerance = _TOLERANCE * float(np.ptp(margins.avoid)) if tolerance is None else tolerance
        values = self._first(*at(0), initial)
        out = values.copy()
        done, change = 0, math.inf
        while done < number and (moving or change > tolerance):
            done += 1
            if moving:
                margins = self._margins(*at(done), discount)
            change = float(kernels().step_back(values, out, margins, self._tables))
            self._grid.fill_outer_ghosts(out)
            values, out = out, values
            if progress is not None:
                progress(done, change)
        converged = horizon is not None or change <= tolerance
        return SafetySolution(self._grid.without_ghosts(values), done, change, converged, time.process_time() - begin)

    def shifted(self, values: ArrayLike, cells: Sequence[int], margin: ArrayLike) -> NDArray[np.float32]:
        """Shift values (grid shape) to a grid that has moved by whole cells; new nodes take the margin.

        Args:
            values: Values on the previous grid.
            cells: Cells that the grid has moved along each axis; 0 along axes that the dynamics depend on.
            margin: Margin on the new grid, broadcast to the grid.

        Raises:
            TimeToReachError: The dynamics depend on an axis that moves, or the shapes do not match.
        """
        given, grid = np.asarray(values, dtype=np.float32), self._grid
        if given.shape != grid.grid_shape or len(cells) != given.ndim:
            raise TimeToReachError(f"values {given.shape} and {len(cells)} shifts: the grid is {grid.grid_shape}")
        fixed = [self.game.axes[k].name for k in grid.order[: grid.n_outer] if cells[k]]
        if fixed:
            raise TimeToReachError(f"the grid cannot move along '{fixed[0]}': the dynamics depend on it")
        out = np.array(np.broadcast_to(np.asarray(margin, dtype=np.float32), given.shape))
        to, source = [slice(None)] * given.ndim, [slice(None)] * given.ndim
        for k, by in enumerate(cells):
            if self.game.axes[k].periodic:
                given = np.roll(given, -by, axis=k)
            else:
                to[k] = slice(max(0, -by), max(0, given.shape[k] - max(0, by)))
                source[k] = slice(max(0, by), max(0, given.shape[k] + min(0, by)))
        out[tuple(to)] = given[tuple(source)]
        return out

    def _tabulate(self, step: float) -> None:
        """Tabulate the steps again if their duration has changed."""
        if not math.isclose(step, self._tabulated, rel_tol=1e-9):
            self._grid, self._tables = make_tables(self.game, step, self._width)
            self._tabulated = step

    def _margins(self, margin: ArrayLike, target: ArrayLike | None, discount: float) -> Margins:
        avoid = self._grid.as_blocks("the margin", margin)
        if target is None:
            reach = np.full((1, avoid.shape[1]), -np.inf, np.float32)
        else:
            reach = self._grid.as_blocks("the target", target)
        return Margins(avoid, reach, math.exp(-discount * self._tabulated))

    def _first(self, margin: ArrayLike, target: ArrayLike | None, initial: ArrayLike | None) -> NDArray[np.float32]:
        """Return initial values, flat with ghosts, clipped to the margin."""
        shape = self._grid.grid_shape
        first = np.asarray(margin, dtype=np.float32)
        if initial is not None:
            given = np.asarray(initial, dtype=np.float32)
            if given.shape != shape or not np.isfinite(given).all():
                raise TimeToReachError(f"the initial values have shape {given.shape}: give finite numbers, {shape}")
            first = np.minimum(first, given)
        elif target is not None:
            first = np.minimum(first, np.asarray(target, dtype=np.float32))
        return self._grid.with_ghosts(np.broadcast_to(first, shape))


def _at(margin: Margin, moment: float) -> ArrayLike:
    return margin(moment) if callable(margin) else margin
