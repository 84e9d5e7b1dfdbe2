"""How a robot moves in a step, fitted to bags: its displacement by the command.

model = fit_motion(transitions)
ends = model(states, actions)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ctrl_rl_core.tasks import wrap
from numpy.typing import NDArray

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import Transitions

Array = NDArray[np.float64]
_FEWEST = 100
_LEAST_EXPLAINED = 0.5


@dataclass(frozen=True)
class MotionModel:
    """Displacement of a step, linear in `features` of the action.

    Attributes:
        weights: Displacement ahead [m], to the left [m] and around [rad] for each feature (7, 3).
        explained: Share of the variance ahead and around that the actions explain (2,).
    """

    weights: Array
    explained: Array

    def __call__(self, states: Array, actions: Array, part: float = 1.0) -> Array:
        """Return states (N, 3) x, y, theta after a part of a step with actions (N, 2) from states (N, 3)."""
        return displaced(states, part * self.moved(actions))

    def moved(self, actions: Array) -> Array:
        """Return the displacements of a step with actions (N, 2) ahead, to the left and around (N, 3)."""
        return features(actions) @ self.weights


def displaced(states: Array, moved: Array) -> Array:
    """Return states (N, 3) x, y, theta after displacements (N, 3) ahead, to the left and around the body."""
    x, y, theta = states.T
    ahead, left, around = moved.T
    cos, sin = np.cos(theta), np.sin(theta)
    return np.stack((x + cos * ahead - sin * left, y + sin * ahead + cos * left, wrap(theta + around)), axis=1)


def features(actions: Array) -> Array:
    """Return the polynomials of actions (N, 2) that displacements are linear in (N, 7)."""
    v, omega = np.asarray(actions, dtype=np.float64).T
    return np.stack((np.ones_like(v), v, omega, v * omega, v**2, omega**2, v * omega**2), axis=1)


def fit_motion(transitions: Transitions) -> MotionModel:
    """Return the model of the steps that ended no episode, by least squares.

    Raises:
        LearningError: The states are not x, y and theta, the steps are too few, or the commands do not explain them.
    """
    if transitions.states.shape[1] != 3:
        raise LearningError("a model of motion needs states x, y, theta: learn by value_weight")
    inner = transitions.outcomes == 0
    if inner.sum() < _FEWEST:
        raise LearningError(f"{inner.sum()} steps are too few for a model of motion: record {_FEWEST} or more")
    given, moved = features(transitions.actions[inner]), displacements(transitions)[inner]
    weights = np.linalg.lstsq(given, moved, rcond=None)[0]
    explained = 1.0 - (moved - given @ weights).var(axis=0) / np.maximum(moved.var(axis=0), 1e-12)
    if explained[[0, 2]].min() < _LEAST_EXPLAINED:
        raise LearningError(
            f"the commands explain {explained[0]:.0%} of the motion ahead and {explained[2]:.0%} of the turns, less"
            f" than {_LEAST_EXPLAINED:.0%}: is the robot late or held back? learn by value_weight"
        )
    return MotionModel(weights, explained[[0, 2]])


def displacements(transitions: Transitions) -> Array:
    """Return the displacement of each step as the body sees it (N, 3)."""
    dx, dy, turned = (transitions.next_states - transitions.states).T
    cos, sin = np.cos(transitions.states[:, 2]), np.sin(transitions.states[:, 2])
    return np.stack((cos * dx + sin * dy, cos * dy - sin * dx, wrap(turned)), axis=1)


def displacements_before(transitions: Transitions) -> Array:
    """Return the displacements (M, 3) of the step before each, 0 at a start."""
    before = np.roll(displacements(transitions), 1, axis=0)
    before[transitions.first] = 0.0
    return before
