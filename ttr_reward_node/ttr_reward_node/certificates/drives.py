"""Drives by a time-to-reach function: the greedy policy should arrive in about the predicted time.

They reveal values that are too small: from a state that cannot reach the target, the drive does not arrive. Each step
is about a cell long, so the cost depends on the number of cells crossed, not on the speed. If the disturbance has
bounds to choose within, it takes the worst value one step ahead.
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
_PATIENCE = 1.5  # a drive may take this multiple of the predicted time, plus the duration of _SPARE mean steps
_SPARE = 20.0
_TOLD = 0.1  # fraction of the predicted time after which a drive is conclusive
_HOPELESS = 5.0  # multiple of the predicted time from which a drive counts as failed
_MOST_STEPS = 400
_MOST_LOOKS = 600_000  # evaluations of one control and disturbance


@dataclass(frozen=True, eq=False)
class Drives:
    """Outcome of drives from N states.

    Attributes:
        states: Start states (N, n).
        promised: Values at the start states (N,) [s].
        taken: Executed time to the target (N,) [s]; inf for failed drives. For drives still running after the last
            step, the time extrapolated from their progress.
        step: Mean duration of a step of about one cell (N,) [s].
        ended: Whether each drive arrived or failed (N,).
        told: Whether each drive is conclusive: it has ended, or run long enough to extrapolate (N,).
    """

    states: Array
    promised: Array
    taken: Array
    step: Array
    ended: Flags
    told: Flags

    @property
    def arrives(self) -> Flags:
        """Whether each drive has reached the target or approaches it (N,)."""
        return np.isfinite(self.taken)


def drive(
    value: ValueFunction,
    problem: TimeToReachProblem,
    states: Array,
    most_steps: int = _MOST_STEPS,
    most_looks: float = _MOST_LOOKS,
) -> Drives:
    """Drive from states (N, n) with positive, finite values.

    Args:
        value: Time-to-reach function to follow.
        problem: Problem to drive in.
        states: Start states.
        most_steps: Maximum number of steps per drive.
        most_looks: Maximum number of evaluations of a control and disturbance, over all drives; the simulation then
            stops.
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
    # Extrapolate running drives by elapsed seconds per second of decrease in the value.
    nearer = promised[running] - value.value(now[running])
    pace = np.divide(elapsed[running], nearer, out=np.full(len(running), np.inf), where=nearer > 0.0)
    taken[running] = np.where(pace < _HOPELESS, pace * promised[running], np.inf)
    told = ended | (elapsed > _TOLD * promised)
    return Drives(states, promised, taken, elapsed / np.maximum(number, 1.0), ended, told)
