"""Prediction errors of a model over those of "nothing changes", and lower bounds of them.

`predict` returns the next z (N, n) of z (N, n) and actions (N, m); `z` are the latents of each episode (T + 1, n), and
`actions` those that were done in it (T, m).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.least_squares import LeastSquares

Predict = Callable[[Array, Array], Array]

HORIZON = 10
"""Steps that a model's error is told for."""


def squared_error(predict: Predict, z: Sequence[Array], actions: Sequence[Array]) -> float:
    """Return the mean squared error of one step, over all components: the thesis's model error."""
    missed = [here[1:] - predict(here[:-1], done) for here, done in zip(z, actions, strict=True)]
    return float(np.mean(np.concatenate(missed) ** 2))


def horizon_errors(predict: Predict, z: Sequence[Array], actions: Sequence[Array], steps: int) -> list[float]:
    """Return the error over that of persistence after 1, 2, ... `steps` steps, over all components.

    The model goes on from its own prediction, under the actions that were done; the longest episode bounds the steps.

    Raises:
        KoopmanError: there is not one step.
    """
    steps = min(steps, max((len(each) for each in actions), default=0))
    if steps < 1:
        raise KoopmanError("no episode to measure the model on")
    missed, moved = np.zeros(steps), np.zeros(steps)
    for here, done in zip(z, actions, strict=True):
        predicted = here
        for step in range(min(steps, len(done))):
            predicted = predict(predicted[:-1], done[step:])
            missed[step] += np.sum((here[step + 1 :] - predicted) ** 2)
            moved[step] += np.sum((here[step + 1 :] - here[: -step - 1]) ** 2)
    return [float(each) for each in np.sqrt(missed / np.maximum(moved, np.finfo(float).tiny))]


def law_error(predict: Predict, K: Array, z: Sequence[Array], actions: Sequence[Array]) -> float:
    """Return the error over persistence, after one step, in what the law asks for: in K z.

    Unlike that of z it is the same in all coordinates of the latent space: a component that is easy to predict cannot
    make up for those that the law looks at by being large. The rows of the gain K (m, n) are in like units.
    """
    missed = [(here[1:] - predict(here[:-1], done)) @ K.T for here, done in zip(z, actions, strict=True)]
    return _over_persistence(missed, [each @ K.T for each in z])


def noise_floor(z: Sequence[Array], again: Sequence[Array]) -> float:
    """Return the error over persistence, after one step, that the sensor's noise alone makes.

    Two looks at one state, `z` and `again`, differ by noise. Half of its mean square is what is missed by who knows the
    next state: no model, linear or not, misses less.
    """
    return _over_persistence([np.sqrt(0.5) * (one - two)[1:] for one, two in zip(z, again, strict=True)], z)


def linear_floor(z: Sequence[Array], actions: Sequence[Array]) -> float:
    """Return the error over persistence, after one step, of the linear model that is fitted to these very steps.

    No linear model of these latents misses less of them, whatever it was fitted to: what of it is not noise is not
    linear in z and u. With a tenth as many regressors as there are steps it is 5 % too low.
    """
    here = np.hstack((np.concatenate([each[:-1] for each in z]), np.concatenate(actions)))
    regressors = np.hstack((here, np.ones((len(here), 1))))
    moved = np.concatenate([np.diff(each, axis=0) for each in z])
    fitted = regressors @ LeastSquares(regressors).solve(moved)
    return _over_persistence([moved - fitted], z)


def _over_persistence(missed: Sequence[Array], z: Sequence[Array]) -> float:
    moved = sum(float(np.sum(np.diff(each, axis=0) ** 2)) for each in z)
    return float(np.sqrt(sum(float(np.sum(each**2)) for each in missed) / max(moved, np.finfo(float).tiny)))
