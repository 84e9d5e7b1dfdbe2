"""How far a model's prediction is off, over what "nothing changes" is off, for one step and for more."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError

Array = NDArray[np.float64]


Predict = Callable[[Array, Array], Array]


def squared_error(predict: Predict, z: Sequence[Array], actions: Sequence[Array]) -> float:
    """Return the mean squared error of one step, over all components: the thesis's model error.

    Args:
        predict: next z (N, n) of z (N, n) and actions (N, m).
        z: of each episode (T + 1, n).
        actions: of each episode (T, m).
    """
    missed = [here[1:] - predict(here[:-1], done) for here, done in zip(z, actions, strict=True)]
    return float(np.mean(np.concatenate(missed) ** 2))


def horizon_errors(predict: Predict, z: Sequence[Array], actions: Sequence[Array], steps: int) -> list[float]:
    """Return the error over that of persistence after 1, 2, ... `steps` steps, over all components.

    The model goes on from its own prediction, under the actions that were done.

    Args:
        predict: next z (N, n) of z (N, n) and actions (N, m).
        z: of each episode (T + 1, n).
        actions: of each episode (T, m).
        steps: how many; errors beyond the longest episode are left out.

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
