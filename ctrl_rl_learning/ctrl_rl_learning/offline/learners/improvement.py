"""Better commands for recorded states, by a value function and a model of motion from the bags."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.motion import MotionModel
from ctrl_rl_learning.offline.data.values import StateValues

Array = NDArray[np.float64]
_CANDIDATES = 9  # of each of the two commands
_AT_ONCE = 512


def improved_actions(
    states: Array, model: MotionModel, values: StateValues, temperature: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return better actions (N, 2), and where they are known (N,): not where every action ends too near to an obstacle.

    An action is the mean of a grid of actions, weighted by exp(Q / temperature).
    Q is reward and value of where the model says that a step ends, in units of the usual difference between the best
    action of a state and the middle one. A soft maximum changes gradually from state to state, as a network can.

    Args:
        states: States x, y, theta (N, 3).
        model: Model of the robot's motion in a step.
        values: Value function that the actions are judged by.
        temperature: Difference of Q that multiplies a weight by e.

    Raises:
        LearningError: They are known nowhere.
    """
    side = np.linspace(-1.0, 1.0, _CANDIDATES)
    actions = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    worth = np.concatenate(
        [_worth(states[first : first + _AT_ONCE], actions, model, values) for first in range(0, len(states), _AT_ONCE)]
    )
    best = worth.max(axis=1, keepdims=True)
    known = best[:, 0] > worth.min()
    if not known.any():
        raise LearningError("the value function knows no way to the goal from where the bags drove: is it this task's?")
    unit = max(float(np.median(best[known] - np.median(worth[known], axis=1, keepdims=True))), 1e-9)
    weights = np.exp((worth - best) / (temperature * unit))
    return weights @ actions / weights.sum(axis=1, keepdims=True), known


def _worth(states: Array, actions: Array, model: MotionModel, values: StateValues) -> Array:
    """Return Q (N, K) of each of K actions at each of N states."""
    from_each = np.repeat(states, len(actions), axis=0)
    each = np.tile(actions, (len(states), 1))
    worth = values.after_step(model(from_each, each, 0.5), model(from_each, each))
    return worth.reshape(len(states), len(actions))
