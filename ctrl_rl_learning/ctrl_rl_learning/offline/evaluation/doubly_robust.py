"""Weighted doubly robust evaluation (Thomas, Brunskill 2016), for deterministic policies and an unknown driver.

The driver is taken for a normal distribution around what was cloned from it. The policy counts as a narrow normal
distribution around its command, since a deterministic one never does exactly what was recorded.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.offline.data.transitions import Transitions
from ctrl_rl_learning.offline.evaluation.fitted_q import PolicyValues

Array = NDArray[np.float64]
_LARGEST_RATIO = 3.0
_WIDTH = 0.7
"""Width of the policy's distribution over the driver's."""


def step_ratios(transitions: Transitions, cloned: NDArray[np.float32], own: NDArray[np.float32]) -> Array:
    """Return how much likelier each command was under the policy than under the driver (N,), cut off.

    Args:
        transitions: Transitions of the driver.
        cloned: Actions (N, 2) of a clone of the driver.
        own: Actions (N, 2) of the policy.
    """
    spread = np.maximum((transitions.actions - cloned).std(axis=0), 0.05)
    width = _WIDTH * spread
    driver = -0.5 * (((transitions.actions - cloned) / spread) ** 2).sum(axis=1) - np.log(spread).sum()
    policy = -0.5 * (((transitions.actions - own) / width) ** 2).sum(axis=1) - np.log(width).sum()
    return np.asarray(np.minimum(np.exp(np.minimum(policy - driver, 10.0)), _LARGEST_RATIO), dtype=np.float64)


def episode_estimates(
    transitions: Transitions, values: PolicyValues, ratios: Array, discount: float
) -> tuple[Array, float]:
    """Return the estimate of each episode (episodes,), whose mean is the policy's return, and the effective episodes.

    Each begins with the fitted value of its first observation; what followed corrects it, weighted by how likely the
    policy would have done the same so far. The weights of a step are scaled to a mean of 1 over the episodes.
    """
    starts = np.flatnonzero(transitions.first)
    number = np.cumsum(transitions.first) - 1
    step = np.arange(len(transitions)) - starts[number]
    logs = np.log(np.maximum(ratios, 1e-12))
    total = np.cumsum(logs)
    weights = np.exp(total - (total - logs)[starts][number])
    sums = np.bincount(step, weights)
    # Episodes that are over count with their last weight, so that long ones do not gain from being the only ones left.
    ends = np.append(starts[1:], len(transitions)) - 1
    over = np.zeros(len(sums) + 1)
    np.add.at(over, step[ends] + 1, weights[ends])
    means = np.maximum((sums + np.cumsum(over)[:-1]) / len(starts), 1e-12)
    weights = weights / means[step]
    error = transitions.task_rewards + discount * values.after - values.given
    corrections = np.add.reduceat(weights * discount**step * error, starts)
    last = weights[ends]
    effective = float(last.sum() ** 2 / max(float((last**2).sum()), 1e-12))
    return values.before[starts] + corrections, effective
