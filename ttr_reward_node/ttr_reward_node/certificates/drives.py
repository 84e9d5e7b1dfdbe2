"""Drives by a time to reach: the greedy policy should arrive, in about the time that was promised.

They show where values are too small: a state from which nothing leads to the target does not arrive. A drive takes
steps of a cell, so it costs as many steps as it crosses cells, at whatever speed. Where the disturbance has room it is
the one that looks worst a step ahead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ValueFunction
from ttr_reward_node.certificates.greedy import GRAZE, Greedy
from ttr_reward_node.certificates.local_steps import LocalSteps
from ttr_reward_node.problems.problem import TimeToReachProblem

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_PATIENCE = 1.5  # times what was promised, beyond the time of so many steps:
_SPARE = 20.0
_TOLD = 0.1  # of the promised time, after which a drive tells how it goes on
_HOPELESS = 5.0  # times as long as promised: no drive that arrives
_MOST_STEPS = 400
_MOST_LOOKS = 600_000  # at what a control leads to


@dataclass(frozen=True, eq=False)
class Drives:
    """Outcome of the drives from some states.

    Attributes:
        states: Where they began (N, n).
        promised: Value there (N,) [s].
        taken: Time that the way to the target took (N,) [s]; inf of those that failed. Of those that were still under
            way after the most steps, what it will take if they go on as so far.
        step: Mean duration of a step, about a cell (N,) [s].
        ended: Whether each arrived or failed (N,).
        told: Whether each has ended, or gone far enough to tell how it goes on (N,).
    """

    states: Array
    promised: Array
    taken: Array
    step: Array
    ended: Flags
    told: Flags

    @property
    def arrives(self) -> Flags:
        """Whether each has reached the target, or comes nearer to it (N,)."""
        return np.isfinite(self.taken)


def drive(
    value: ValueFunction,
    problem: TimeToReachProblem,
    states: Array,
    most_steps: int = _MOST_STEPS,
    most_looks: float = _MOST_LOOKS,
) -> Drives:
    """Drive from states (N, n) with finite values above 0.

    Args:
        value: Time to reach to follow.
        problem: Problem to drive in.
        states: Where the drives begin.
        most_steps: Number of steps after which a drive is not followed further.
        most_looks: Number of looks at what a control leads to, of all drives together, after which none is.
    """
    steps = LocalSteps(problem)
    greedy = Greedy(value, steps)
    promised, count = value.value(states), len(states)
    taken, elapsed, number = np.full(count, np.inf), np.zeros(count), np.zeros(count)
    now, running = states.copy(), np.arange(count)
    looks, each = 0, len(problem.control_samples) * len(problem.system.disturbance_samples(2))
    for _ in range(most_steps):
        looks += each * len(running)
        if not len(running) or looks > most_looks:
            break
        at = now[running]
        u, d, h = greedy.choose(at)
        end = steps.move(at, u, d, h)
        points = steps.chord(at, end)
        there, hit = problem.reached(points), steps.clearance(points) < -GRAZE
        first = np.where(there.any(axis=0), there.argmax(axis=0), len(points))
        struck = (hit & (np.arange(len(points))[:, None] < first)).any(axis=0)
        arrived = there.any(axis=0) & ~struck
        elapsed[running] += h * np.where(arrived, (first + 0.5) / len(points), 1.0)
        number[running] += 1.0
        taken[running[arrived]] = elapsed[running[arrived]]
        late = elapsed[running] > _PATIENCE * promised[running] + _SPARE * elapsed[running] / number[running]
        now[running] = steps.on_grid(end)
        running = running[~(arrived | struck | late | steps.beyond(end, GRAZE) | (h <= 0.0))]
    ended = np.ones(count, dtype=bool)
    ended[running] = False
    # By the time that has passed for each second that the value has become less.
    nearer = promised[running] - value.value(now[running])
    pace = np.divide(elapsed[running], nearer, out=np.full(len(running), np.inf), where=nearer > 0.0)
    taken[running] = np.where(pace < _HOPELESS, pace * promised[running], np.inf)
    told = ended | (elapsed > _TOLD * promised)
    return Drives(states, promised, taken, elapsed / np.maximum(number, 1.0), ended, told)
