"""Checks of the references that need no grid: linear programs, and states that are followed by small steps."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog

from referee.case import Array
from ttr_reward_node import TimeToReachProblem

PIECES = 250
STEPS = 4000


def can_be_in_target(problem: TimeToReachProblem, state: Array, time: float) -> bool:
    """Return whether a linear system without disturbance can be in its box at a time, by a linear program.

    The controls are held over each of `PIECES` pieces of the time. Bounds of the states are not looked at.
    """
    system, n, m = problem.system, len(problem.axes), len(problem.system.controls)
    zero, still = np.zeros(n), np.zeros(m)
    constant = system.dynamics(zero, still)
    matrix = np.array([system.dynamics(row, still) - constant for row in np.eye(n)]).T
    column = np.array([system.dynamics(zero, row) - constant for row in np.eye(m)]).T
    whole = np.zeros((n + m + 1, n + m + 1))
    whole[:n] = np.concatenate((matrix, column, constant[:, None]), axis=1)
    step = expm(whole * time / PIECES)
    moved, held, drift = step[:n, :n], step[:n, n : n + m], step[:n, -1]
    columns, later, end = [], np.eye(n), np.zeros(n)
    for _ in range(PIECES):  # from the last piece to the first
        columns.append(later @ held)
        end = end + later @ drift
        later = later @ moved
    end = end + later @ state
    box = np.array([problem.target.intervals[name] for name in system.state_names])
    size = box[:, 1] - box[:, 0]
    gain = np.concatenate(columns, axis=1) / size[:, None]
    answer = linprog(
        np.zeros(gain.shape[1]),
        A_ub=np.concatenate((gain, -gain)),
        b_ub=np.concatenate(((box[:, 1] - end) / size, (end - box[:, 0]) / size)),
        bounds=list(system.control_bounds.T) * PIECES,
        method="highs",
    )
    return bool(answer.status == 0)


def follow(problem: TimeToReachProblem, states: Array, horizon: float) -> Array:
    """Return when each state (N, n) without a control is first in the target [s]; +inf where it leaves, or later."""
    dt, arrived = horizon / STEPS, np.full(len(states), np.inf)
    lost = np.zeros(len(states), dtype=bool)
    controls = np.zeros((len(states), len(problem.system.controls)))
    for k in range(STEPS):
        inside = problem.target.contains(problem.system.state_names, states) & ~lost
        arrived = np.where(inside, np.minimum(arrived, k * dt), arrived)
        states = problem.system.wrap(problem.system.step(states, controls, dt=dt))
        for i, axis in enumerate(problem.axes):
            lost |= (states[:, i] < axis.lower) | (states[:, i] > axis.upper)
    return arrived
