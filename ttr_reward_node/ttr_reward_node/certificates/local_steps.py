"""Steps of a fixed length in cells: fast states take short steps in time, slow states long ones."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ttr_reward_node.problems.problem import TimeToReachProblem

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_CHORD = np.array([0.25, 0.5, 0.75, 1.0])
"""Fractions of a step at which target and obstacles are checked."""


class LocalSteps:
    """Steps of a problem's system, measured in cells of its grid.

    Args:
        problem: Problem with the system, the axes and the obstacles.
    """

    def __init__(self, problem: TimeToReachProblem) -> None:
        self.problem = problem
        self._f = problem.system.equations(np, problem.system.parameters)
        self.spacings = np.array([axis.spacing for axis in problem.axes])

    def rates(self, states: Array, u: Array, d: Array) -> Array:
        """Return the derivatives (..., n) under controls and disturbances that broadcast against the states.

        Same as `System.dynamics` without its checks, which would take longer than evaluating a few hundred states.
        """
        shape = np.broadcast_shapes(states.shape[:-1], u.shape[:-1], d.shape[:-1])
        found = np.empty((*shape, states.shape[-1]))
        for k, rate in enumerate(self._f(_parts(states), _parts(u), _parts(d))):
            found[..., k] = rate
        return found

    def durations(self, states: Array, u: Array, d: Array, cells: float) -> Array:
        """Return the time (...) for each state (..., n) to cross `cells` cells [s]; inf for a state that stands still.

        The speed is the larger of those at the start and half way, because a state at rest may accelerate.
        """
        with np.errstate(all="ignore"):
            rates = self.rates(states, u, d)
            speed = np.abs(rates / self.spacings).max(axis=-1)
            ahead = states + (0.5 * cells / np.where(speed > 0.0, speed, np.inf))[..., None] * rates
            speed = np.fmax(speed, np.abs(self.rates(ahead, u, d) / self.spacings).max(axis=-1))
            return np.asarray(cells / speed)

    def move(self, states: Array, u: Array, d: Array, durations: Array) -> Array:
        """Return the states (..., n) after the durations (...) [s]; negative durations integrate backward.

        Uses the midpoint rule; over one cell its error is far below a cell.
        """
        f, h = self.rates, durations[..., None]
        with np.errstate(all="ignore"):
            return np.asarray(states + h * f(states + 0.5 * h * f(states, u, d), u, d))

    def chord(self, begins: Array, ends: Array) -> Array:
        """Return points (4, ..., n) on the segments from `begins` (..., n) to `ends`; the last are the ends."""
        return begins + _CHORD.reshape(-1, *[1] * begins.ndim) * (ends - begins)

    def on_grid(self, states: Array) -> Array:
        """Return the states (..., n) wrapped along periodic axes and clipped to the limits."""
        return np.clip(self.problem.wrap(states), *self.problem.limits)

    def beyond(self, states: Array, cells: float = 0.0) -> Flags:
        """Whether states (..., n) lie outside the limits by more than `cells` cells, or are not finite."""
        low, high = self.problem.limits
        far = cells * self.spacings + 1e-9 * (self._upper - self._lower)
        inside = (states >= low - far) & (states <= high + far)
        return np.asarray(~inside.all(axis=-1))

    def clearance(self, states: Array) -> Array:
        """Return the distance (...) from states (..., n) to the nearest obstacle [cells]; inf without obstacles."""
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
