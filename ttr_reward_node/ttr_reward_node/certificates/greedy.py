"""The greedy choice of a step: after its control time plus value is least, whatever the disturbance does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ValueFunction
from ttr_reward_node.certificates.local_steps import LocalSteps

Array = NDArray[np.float64]
GRAZE = 0.5
"""Cells by which obstacles and limits may be touched: the grid knows them no better."""
_AHEAD = (2.0, 1.0, 0.3)  # cells; less where everything further off is unreachable
_DONE = 0.5  # of the look-ahead, after which it chooses anew
_CALM = 0.02  # of the time that a longer step may lose
_SHORTEST = 0.125  # of the look-ahead at least, however near the target is


class Greedy:
    """The greedy policy of a value function. Each control is held until it has crossed as many cells as the others.

    Args:
        value: Time to reach to follow.
        steps: Steps of the problem's system.
    """

    def __init__(self, value: ValueFunction, steps: LocalSteps) -> None:
        self._value, self._steps = value, steps
        self._u = steps.problem.control_samples
        self._d = steps.problem.system.disturbance_samples(2)

    def choose(self, states: Array) -> tuple[Array, Array, Array]:
        """Return control (N, m), disturbance (N, n) and duration (N,) [s] at states (N, n); 0 s where nothing moves."""
        u, d = np.zeros((len(states), self._u.shape[1])), np.zeros(states.shape)
        h, left = np.zeros(len(states)), self._value.value(states)
        rows = np.arange(len(states))
        for cells in _AHEAD:
            x = states[rows]
            durations, ahead, times = self._times(x, left[rows], cells)
            at, best = np.arange(len(x)), times.max(axis=2).argmin(axis=1)
            push = times[at, best].argmax(axis=1)
            u[rows], d[rows] = self._u[best], self._d[push]
            h[rows] = np.minimum(_DONE * durations[at, best, push], ahead[at, best, push])
            rows = rows[np.isinf(times[at, best, push])]
            if not len(rows):
                break
        return u, d, h

    def _times(self, states: Array, left: Array, cells: float) -> tuple[Array, Array, Array]:
        """Return full and shortened look-aheads, and what they lead to (N, controls, disturbances) [s]."""
        x, u, d = states[:, None, None], self._u[None, :, None], self._d[None, None]
        durations = self._steps.durations(x, u, d, cells)
        # Who stands still, whatever the other does, gets nowhere.
        moving = np.isfinite(durations)
        durations = np.where(moving, durations, 0.0)
        # Not far beyond the target.
        ahead = np.minimum(durations, np.maximum(left[:, None, None], _SHORTEST * durations))
        ends = self._steps.move(x, u, d, ahead)
        times = ahead + self._value.value(self._steps.on_grid(ends))
        lost = self._steps.beyond(ends, GRAZE) | np.isnan(times) | ~moving
        # Of steps that are about as good the longer one: a fast state need not go to and fro while a slow one moves.
        return durations, ahead, np.where(lost, np.inf, times - _CALM * ahead)
