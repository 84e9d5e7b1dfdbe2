"""Values of states along trajectories (thesis Eq. 3.13) from the task's rewards. NumPy only."""

from __future__ import annotations

import numpy as np
from ctrl_rl_core.tasks import ANGLES, tilt_reward, wrap
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core import NavigationTask, Outcome, TaskSets, terminal_reward
from oc_baseline_node.problems.coordinates import nearest_turn

Array = NDArray[np.float64]


def step_discount(task: NavigationTask, discount: float, time_steps: ArrayLike) -> Array:
    """Return the discount of MPC steps of duration `time_steps` [s] (...), given the discount per policy step."""
    return np.power(discount, np.asarray(time_steps, dtype=float) / task.episode.time_step)


def rewards(task: NavigationTask, states: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
    """Return r(x) (Eq. 3.15, 3.17) and whether the episode ends there, both (...), for states (..., n)."""
    states = np.array(states, dtype=float)
    for index, state in enumerate(task.system.build().states):  # regions identify angles only, by name
        if state.periodic and state.name not in ANGLES and state.name in task.goal.region.intervals:
            middle = task.goal.region.intervals[state.name].centre
            states[..., index] = nearest_turn(states[..., index], middle, state.upper - state.lower)
    pays = task.rewards
    outcomes = TaskSets(task).outcomes(states)
    paid = terminal_reward(outcomes, pays, running=pays.intermediate)
    limit, names = task.robot.tilt_limit, task.system.build().state_names
    if limit is not None and "psi" in names:
        paid[np.abs(wrap(states[..., names.index("psi")])) > limit] = tilt_reward(pays)
    return paid, outcomes != Outcome.RUNNING


def returns(paid: ArrayLike, ended: ArrayLike, discount: ArrayLike) -> Array:
    """Return V(x_m) = sum over i >= m of discount^(i-m) r(x_i) (..., H+1): Eq. 3.13 with r(x_i) in place of r(x_m).

    The sum stops at the first state that ends an episode, as for the policy: H_j is the step of arrival.

    Args:
        paid: Rewards r(x_0) .. r(x_H) (..., H+1).
        ended: Whether the episode ends there (..., H+1); all False to sum over the whole horizon.
        discount: Discount of each step (...), or a single one.
    """
    paid, goes_on = np.asarray(paid, dtype=float), ~np.asarray(ended, dtype=bool)
    out = paid.copy()
    for m in range(paid.shape[-1] - 2, -1, -1):
        out[..., m] += goes_on[..., m] * discount * out[..., m + 1]
    return out
