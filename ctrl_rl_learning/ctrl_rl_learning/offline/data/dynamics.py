"""How a robot moves step after step, fitted to bags: a step's displacement by its command and by the step before.

dynamics = fit_dynamics(transitions)
ends, moved = dynamics(states, actions, moved, random)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.offline.data.motion import displaced, displacements, features
from ctrl_rl_learning.offline.data.transitions import Transitions

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Dynamics:
    """Displacements with memory: a robot that is still speeding up goes less far than its command says.

    Attributes:
        weights: Displacement ahead [m], to the left [m] and around [rad] for each feature (k, 3).
        errors: Parts of the recorded displacements that the features do not explain (M, 3).
    """

    weights: Array
    errors: Array

    def __call__(
        self, states: Array, actions: Array | NDArray[np.float32], before: Array, random: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return states (N, 3) x, y, theta after a step, and its displacements (N, 3), each with a recorded error.

        Args:
            states: States before (N, 3).
            actions: Actions in [-1, 1] (N, 2).
            before: Displacements of the step before (N, 3), 0 at a start.
            random: Draws the errors.
        """
        moved = (
            _remembering(actions, before) @ self.weights
            + self.errors[random.integers(len(self.errors), size=len(states))]
        )
        return displaced(states, moved), moved


def fit_dynamics(transitions: Transitions) -> Dynamics:
    """Return the dynamics of the steps that ended no episode, by least squares; states are x, y, theta."""
    moved, before = displacements(transitions), displacements_before(transitions)
    inner = transitions.outcomes == 0
    given = _remembering(transitions.actions, before)[inner]
    weights = np.linalg.lstsq(given, moved[inner], rcond=None)[0]
    return Dynamics(weights, moved[inner] - given @ weights)


def displacements_before(transitions: Transitions) -> Array:
    """Return the displacements (M, 3) of the step before each, 0 at a start."""
    before = np.roll(displacements(transitions), 1, axis=0)
    before[transitions.first] = 0.0
    return before


def _remembering(actions: Array | NDArray[np.float32], before: Array) -> Array:
    """Return the features (N, k) of actions (N, 2) and the displacements before (N, 3)."""
    given = np.asarray(actions, dtype=np.float64)
    mixed = [before * given[:, [command]] for command in range(2)]
    return np.concatenate((features(given), before, before**2, *mixed), axis=1)
