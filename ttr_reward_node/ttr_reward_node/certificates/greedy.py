"""Greedy choice of a control: it minimises elapsed time plus value after a step, for the worst disturbance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ValueFunction
from ttr_reward_node.certificates.local_steps import LocalSteps

Array = NDArray[np.float64]
GRAZE = 0.5
"""Tolerated penetration of obstacles and limits [cells], because the grid does not resolve them better."""
_AHEAD = (2.0, 1.0, 0.3)  # look-aheads [cells]; a shorter one is used where the longer ends are all unreachable
_DONE = 0.5  # fraction of the look-ahead after which the next control is chosen
_CALM = 0.02  # bonus for longer steps, as a fraction of their duration
_SHORTEST = 0.125  # minimum fraction of the look-ahead, however near the target is


class Greedy:
    """Greedy policy of a value function. Each control is held until it has crossed the same number of cells.

    Args:
        value: Time-to-reach function to follow.
        steps: Steps of the problem's system.
    """

    def __init__(self, value: ValueFunction, steps: LocalSteps) -> None:
        self._value, self._steps = value, steps
        self._u = steps.problem.control_samples
        self._d = steps.problem.system.disturbance_samples(2)

    def choose(self, states: Array) -> tuple[Array, Array, Array]:
        """Return control (N, m), disturbance (N, n) and duration (N,) [s] at states (N, n); 0 s if nothing moves."""
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
        """Return full look-aheads, shortened ones, and the resulting times (N, controls, disturbances) [s]."""
        x, u, d = states[:, None, None], self._u[None, :, None], self._d[None, None]
        durations = self._steps.durations(x, u, d, cells)
        # A pair under which the state stands still does not lead to the target.
        moving = np.isfinite(durations)
        durations = np.where(moving, durations, 0.0)
        # Do not look far beyond the target.
        ahead = np.minimum(durations, np.maximum(left[:, None, None], _SHORTEST * durations))
        ends = self._steps.move(x, u, d, ahead)
        times = ahead + self._value.value(self._steps.on_grid(ends))
        lost = self._steps.beyond(ends, GRAZE) | np.isnan(times) | ~moving
        # Prefer the longer of nearly equal steps, so that a fast state does not chatter while a slow one moves.
        return durations, ahead, np.where(lost, np.inf, times - _CALM * ahead)
