"""How a robot moves in a step, with memory, fitted to bags; and how it goes on where the bags say nothing.

dynamics = fit_dynamics(transitions)
ends, moved = dynamics(states, inputs, random)
capped = replace(dynamics, capped=True)          # beyond the bags the robot moves as it did at their edge
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.offline.data.motion import displaced, displacements, displacements_before, features
from ctrl_rl_learning.offline.data.transitions import Transitions

Array = NDArray[np.float64]
_EDGES = 0.01
"""Share of the recorded inputs on either side that does not count as known: too few to fit a bend by."""
_LARGEST_ERROR = 4.0
_RIDGE = 1e-6


@dataclass(frozen=True)
class Dynamics:
    """Displacement of a step by its inputs: action (2), displacement of the step before (3), action before (2).

    Within the inputs that the bags know, displacements are polynomials of them. A polynomial says nothing beyond: there
    the displacement at the edge goes on as a straight line, along the arc of a robot on wheels, or stays as it was at
    the edge (`capped`). A robot that is only told to go faster lies between the two.

    Attributes:
        weights: Displacement ahead [m], to the left [m] and around [rad] for each polynomial (k, 3).
        line: The same for 1 and each input (8, 3).
        low, high: Inputs that the bags know (7,).
        errors: Parts of the recorded displacements that the polynomials do not explain (M, 3).
        capped: Whether the robot moves beyond the known inputs as it did at their edge.
    """

    weights: Array
    line: Array
    low: Array
    high: Array
    errors: Array
    capped: bool = False

    def __call__(self, states: Array, inputs: Array, random: np.random.Generator) -> tuple[Array, Array]:
        """Return states (N, 3) x, y, theta after a step, and its displacements (N, 3), each with a recorded error.

        Args:
            states: States before (N, 3).
            inputs: Inputs of the step (N, 7), see `inputs_of`.
            random: Draws the errors, which grow beyond the known inputs.
        """
        known = np.clip(inputs, self.low, self.high)
        moved = _polynomials(known) @ self.weights
        beyond = inputs - known
        if not self.capped:
            ahead, _, around = (moved + beyond @ self.line[1:]).T
            arc = np.stack((ahead, ahead * np.tan(np.clip(0.5 * around, -1.4, 1.4)), around), axis=1)
            moved = np.where(beyond.any(axis=1, keepdims=True), arc, moved)
        growth = np.minimum(1.0 + self.distance(inputs), _LARGEST_ERROR)
        moved = moved + growth[:, None] * self.errors[random.integers(len(self.errors), size=len(states))]
        return displaced(states, moved), moved

    def distance(self, inputs: Array) -> Array:
        """Return how far inputs (N, 7) lie outside the known ones (N,), in halves of the known ranges."""
        half = np.maximum(0.5 * (self.high - self.low), 0.05)
        distances: Array = (np.abs(inputs - np.clip(inputs, self.low, self.high)) / half).max(axis=1)
        return distances


def inputs_of(actions: NDArray[np.floating], moved: Array, before: NDArray[np.floating]) -> Array:
    """Return the inputs (N, 7) of steps.

    Args:
        actions: Actions in [-1, 1] (N, 2).
        moved: Displacements of the steps before (N, 3), 0 at a start.
        before: Actions of the steps before (N, 2); at a start those of a robot at rest.
    """
    return np.concatenate((actions, moved, before), axis=1, dtype=np.float64)


def recorded_inputs(transitions: Transitions, rest: Array) -> Array:
    """Return the inputs (M, 7) of recorded steps.

    Args:
        transitions: Transitions, whose states are x, y, theta.
        rest: Action (2,) of a robot at rest.
    """
    before = np.roll(transitions.actions.astype(np.float64), 1, axis=0)
    before[transitions.first] = rest
    return inputs_of(transitions.actions, displacements_before(transitions), before)


def fit_dynamics(transitions: Transitions, rest: Array) -> Dynamics:
    """Return the dynamics of the steps that ended no episode, by least squares; states are x, y, theta.

    Args:
        transitions: Transitions to fit to.
        rest: Action (2,) of a robot at rest.
    """
    inner = transitions.outcomes == 0
    inputs, moved = recorded_inputs(transitions, rest)[inner], displacements(transitions)[inner]
    given = _polynomials(inputs)
    weights = _least_squares(given, moved)
    line = _least_squares(np.concatenate((np.ones((len(inputs), 1)), inputs), axis=1), moved)
    low, high = np.quantile(inputs, (_EDGES, 1.0 - _EDGES), axis=0)
    return Dynamics(weights, line, low, high, moved - given @ weights)


def _least_squares(given: Array, wanted: Array) -> Array:
    """Return weights (k, 3); what the bags do not vary gets none."""
    scale = np.maximum(np.abs(given).max(axis=0), 1e-9)
    scaled = given / scale
    normal = scaled.T @ scaled + _RIDGE * len(given) * np.eye(given.shape[1])
    return np.asarray(np.linalg.solve(normal, scaled.T @ wanted) / scale[:, None], dtype=np.float64)


def _polynomials(inputs: Array) -> Array:
    """Return the polynomials (N, k) of inputs (N, 7)."""
    actions, moved, before = inputs[:, :2], inputs[:, 2:5], inputs[:, 5:]
    mixed = [moved * actions[:, [command]] for command in range(2)]
    return np.concatenate((features(actions), moved, moved**2, *mixed, before), axis=1)
