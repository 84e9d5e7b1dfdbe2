"""Roll-outs of the greedy policy of a value function: executed and predicted times.

    outcome = roll_out(solution.grid, problem, states, world=task.build_world())
    outcome.reached.mean(), np.median(outcome.ratio)

The greedy control is the sample that leads to the smallest time to reach after a short look-ahead. This is the
minimiser of thesis Eq. 3.4, computed from values rather than from their gradient, which is undefined at jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import ValueFunction, World, position_indices
from ttr_reward_node.errors import TimeToReachError
from ttr_reward_node.problems.problem import TimeToReachProblem
from ttr_reward_node.solvers.steps import crossing_time

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RollOuts:
    """Results of the roll-outs from N starts.

    Attributes:
        predicted: Value at the start (N,) [s].
        executed: Time until the target (N,) [s], NaN if not reached.
        reached, collided, left: Whether each roll-out reached the target, collided, or left the grid or the state's own
            bounds (N,); all false if it ran out of time.
        last: Final state (N, n).
    """

    predicted: Array
    executed: Array
    reached: NDArray[np.bool_]
    collided: NDArray[np.bool_]
    left: NDArray[np.bool_]
    last: Array

    @property
    def ratio(self) -> Array:
        """Executed / predicted time of roll-outs that reached the target; 1 for those that started in it."""
        executed, predicted = self.executed[self.reached], self.predicted[self.reached]
        at_once = np.where(executed > 0.0, np.inf, 1.0)  # for a prediction of 0
        return np.divide(executed, predicted, out=at_once, where=predicted > 0.0)


def best_control(
    value: ValueFunction, problem: TimeToReachProblem, states: Array, controls: Array, look_ahead: float
) -> NDArray[np.int64]:
    """Return the index of the greedy control (N,) at states (N, n), among controls (k, m)."""
    chosen = np.zeros(len(states), dtype=np.int64)
    open_ = np.arange(len(states))
    # If every control leads to unreachable states, shorten the look-ahead.
    for reach in (look_ahead, 0.5 * look_ahead, 0.1 * look_ahead):
        ends = problem.system.step(states[open_, None], controls, dt=reach)
        times = value.value(ends)
        times = np.where(np.isnan(times), np.inf, times)
        best = np.argmin(times, axis=1)
        chosen[open_] = best
        open_ = open_[np.isinf(times[np.arange(len(best)), best])]
        if not len(open_):
            break
    return chosen


def roll_out(
    value: ValueFunction,
    problem: TimeToReachProblem,
    states: ArrayLike,
    *,
    world: World | None = None,
    time_step: float | None = None,
    look_ahead: float | None = None,
    patience: float = 2.0,
) -> RollOuts:
    """Simulate from states (N, n) until each has reached the target, failed, or run out of time.

    The disturbance is the system's nominal one: zero, or the constant value set by its bounds.

    Args:
        value: Time-to-reach function that predicts the time and determines the control.
        problem: Problem with the system, target and domain to simulate.
        states: Start states.
        world: World with the true walls and obstacles for collisions, instead of the grid's; none by default.
        time_step: Time for which a control is held [s]; default: a fifth of the time to cross a cell.
        look_ahead: Look-ahead of the policy [s]; default: one and a half times the time to cross a cell.
        patience: Multiple of the predicted time after which a roll-out ends, plus the time to cross ten cells.

    Raises:
        TimeToReachError: There is no finite prediction at a state.
    """
    x = problem.wrap(np.atleast_2d(np.asarray(states, dtype=np.float64)))
    predicted = value.value(x)
    if not np.isfinite(predicted).all():
        bad = x[~np.isfinite(predicted)][0]
        raise TimeToReachError(f"the time to reach at {bad.tolist()} is not finite: start from another state")
    unit = crossing_time(problem)
    time_step = 0.2 * unit if time_step is None else time_step
    look_ahead = 1.5 * unit if look_ahead is None else look_ahead
    controls = problem.control_samples
    count = len(x)
    executed, last = np.full(count, np.nan), x.copy()
    reached, collided, left = (np.zeros(count, dtype=bool) for _ in range(3))
    running = np.arange(count)
    plane = position_indices(problem.system.state_names)
    time = 0.0
    while len(running):
        now = last[running]
        inside = problem.reached(now)
        hit = np.zeros(len(running), dtype=bool) if world is None else world.signed_distance(now[:, plane]) <= 0.0
        out = problem.left(now) & ~hit
        reached[running] = inside & ~hit & ~out
        collided[running], left[running] = hit, out
        executed[running[inside & ~hit & ~out]] = time
        late = time > patience * predicted[running] + 10.0 * unit
        running = running[~(inside | hit | out | late)]
        x = last[running]
        u = controls[best_control(value, problem, x, controls, look_ahead)]
        last[running] = problem.wrap(problem.system.step(x, u, dt=time_step))
        time += time_step
    return RollOuts(predicted, executed, reached, collided, left, last)
