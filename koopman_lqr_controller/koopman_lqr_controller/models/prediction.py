"""Prediction errors of a model relative to persistence, and their lower bounds.

`predict` returns the next z (N, n) for z (N, n) and actions (N, m); `z` are the latents of each episode (T + 1, n), and
`actions` the executed actions (T, m).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.least_squares import LeastSquares

Predict = Callable[[Array, Array], Array]

HORIZON = 10
"""Number of steps for which a model's error is reported."""


def squared_error(predict: Predict, z: Sequence[Array], actions: Sequence[Array]) -> float:
    """Return the mean squared one-step error over all components, the thesis's model error."""
    missed = [here[1:] - predict(here[:-1], done) for here, done in zip(z, actions, strict=True)]
    return float(np.mean(np.concatenate(missed) ** 2))


def horizon_errors(predict: Predict, z: Sequence[Array], actions: Sequence[Array], steps: int) -> list[float]:
    """Return the error relative to persistence after 1, 2, ... `steps` steps, over all components.

    The model continues from its own prediction, under the executed actions; the longest episode limits the steps.

    Raises:
        KoopmanError: There are no steps.
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
    """Return the one-step error of the law's output K z, relative to persistence.

    Unlike the error of z, this error is independent of the latent coordinates: large components that are easy to
    predict cannot mask those used by the law. The rows of the gain K (m, n) have comparable units.
    """
    missed = [(here[1:] - predict(here[:-1], done)) @ K.T for here, done in zip(z, actions, strict=True)]
    return _over_persistence(missed, [each @ K.T for each in z])


def noise_floor(z: Sequence[Array], again: Sequence[Array]) -> float:
    """Return the one-step error relative to persistence that results from sensor noise alone.

    Two observations of one state, `z` and `again`, differ by noise. Half of the mean squared difference is the error of
    a perfect prediction, and thus a lower bound for any model.
    """
    return _over_persistence([np.sqrt(0.5) * (one - two)[1:] for one, two in zip(z, again, strict=True)], z)


def linear_floor(z: Sequence[Array], actions: Sequence[Array]) -> float:
    """Return the one-step error relative to persistence of a linear model fitted to these very steps.

    This is a lower bound for any linear model of these latents: the part that is not noise is nonlinear in z and u. If
    there are ten times as many steps as regressors, the bound is 5 % too low.
    """
    here = np.hstack((np.concatenate([each[:-1] for each in z]), np.concatenate(actions)))
    regressors = np.hstack((here, np.ones((len(here), 1))))
    moved = np.concatenate([np.diff(each, axis=0) for each in z])
    fitted = regressors @ LeastSquares(regressors).solve(moved)
    return _over_persistence([moved - fitted], z)


def _over_persistence(missed: Sequence[Array], z: Sequence[Array]) -> float:
    moved = sum(float(np.sum(np.diff(each, axis=0) ** 2)) for each in z)
    return float(np.sqrt(sum(float(np.sum(each**2)) for each in missed) / max(moved, np.finfo(float).tiny)))
