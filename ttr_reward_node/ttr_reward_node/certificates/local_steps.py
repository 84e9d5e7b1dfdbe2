"""Steps of a length in cells, whatever the speed: fast states take short steps, slow ones long ones."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ttr_reward_node.problems.problem import TimeToReachProblem

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_CHORD = np.array([0.25, 0.5, 0.75, 1.0])
"""Parts of a step at which target and obstacles are looked at."""


class LocalSteps:
    """Steps of a problem's system, in units of the cells of its grid.

    Args:
        problem: Problem with the system, the axes and the obstacles.
    """

    def __init__(self, problem: TimeToReachProblem) -> None:
        self.problem = problem
        self._f = problem.system.equations(np, problem.system.parameters)
        self.spacings = np.array([axis.spacing for axis in problem.axes])

    def rates(self, states: Array, u: Array, d: Array) -> Array:
        """Return the derivatives (..., n) under controls and disturbances that broadcast against the states.

        As `System.dynamics`, without its checks, which would take longer than the equations of some hundred states.
        """
        shape = np.broadcast_shapes(states.shape[:-1], u.shape[:-1], d.shape[:-1])
        found = np.empty((*shape, states.shape[-1]))
        for k, rate in enumerate(self._f(_parts(states), _parts(u), _parts(d))):
            found[..., k] = rate
        return found

    def durations(self, states: Array, u: Array, d: Array, cells: float) -> Array:
        """Return the time (...) in which each state (..., n) crosses so many cells [s]; inf where it stands still.

        A state at rest moves faster a moment later, so the speed is also that half of the way further on.
        """
        with np.errstate(all="ignore"):
            rates = self.rates(states, u, d)
            speed = np.abs(rates / self.spacings).max(axis=-1)
            ahead = states + (0.5 * cells / np.where(speed > 0.0, speed, np.inf))[..., None] * rates
            speed = np.fmax(speed, np.abs(self.rates(ahead, u, d) / self.spacings).max(axis=-1))
            return np.asarray(cells / speed)

    def move(self, states: Array, u: Array, d: Array, durations: Array) -> Array:
        """Return where the states (..., n) are after the durations (...) [s], which are negative for the way back.

        By the midpoint rule: over a cell its error is far below a cell.
        """
        f, h = self.rates, durations[..., None]
        with np.errstate(all="ignore"):
            return np.asarray(states + h * f(states + 0.5 * h * f(states, u, d), u, d))

    def chord(self, begins: Array, ends: Array) -> Array:
        """Return points (4, ..., n) on the way from begins (..., n) to ends, the last ones being the ends."""
        return begins + _CHORD.reshape(-1, *[1] * begins.ndim) * (ends - begins)

    def on_grid(self, states: Array) -> Array:
        """Return the states (..., n) along their periodic axes, and at the limits where they are beyond them."""
        return np.clip(self.problem.wrap(states), *self.problem.limits)

    def beyond(self, states: Array, cells: float = 0.0) -> Flags:
        """Whether states (..., n) are beyond the limits by more than so many cells, or no numbers."""
        low, high = self.problem.limits
        far = cells * self.spacings + 1e-9 * (self._upper - self._lower)
        inside = (states >= low - far) & (states <= high + far)
        return np.asarray(~inside.all(axis=-1))

    def clearance(self, states: Array) -> Array:
        """Return the distance (...) of states (..., n) to the nearest obstacle [cells]; inf where there is none."""
        known = self.problem.clearance
        if known is None:
            return np.full(states.shape[:-1], np.inf)
        axes = list(known.axes)
        at = np.moveaxis((states[..., axes] - self._lower[axes]) / self.spacings[axes], -1, 0)
        return np.asarray(map_coordinates(known.values, at, order=1, mode="nearest") / self.spacings[axes].max())

    @cached_property
    def _lower(self) -> Array:
        return np.array([axis.lower for axis in self.problem.axes])

    @cached_property
    def _upper(self) -> Array:
        return np.array([axis.upper for axis in self.problem.axes])


def _parts(values: Array) -> tuple[Array, ...]:
    return tuple(values[..., k] for k in range(values.shape[-1]))
