"""Drives of known linear systems, and the distance of a model from the true one."""

from collections.abc import Callable

import numpy as np
from koopman_lqr_controller.models.shrinkage import fit_with_shrinkage

from koopman_lqr_controller import LinearModel, Snapshots, fit

Array = np.ndarray
Fit = Callable[[Snapshots], LinearModel]


def shrunk(data: Snapshots) -> LinearModel:
    return fit_with_shrinkage(data).model


def plain(data: Snapshots) -> LinearModel:
    return fit(data, regularisation=0.0)


def driven(true: LinearModel, law: Callable[[int, Array], Array], steps: int, begin: Array) -> Snapshots:
    z, u = [begin], []
    for k in range(steps):
        u.append(law(k, z[-1]))
        z.append(true.predict(z[-1], u[-1]))
    return Snapshots(np.array(z[:-1]), np.array(u), np.array(z[1:]))


def distance(found: LinearModel, true: LinearModel, d: Array, e: Array) -> float:
    """Return the distance of a model in other units from the truth, relative to the larger entries of A and B."""
    A, B = found.A * d / d[:, None], found.B * e / d[:, None]
    return max(
        float(np.abs(A - true.A).max() / np.abs(true.A).max()), float(np.abs(B - true.B).max() / np.abs(true.B).max())
    )


TRUE = LinearModel(np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.1, 0.3], [1.0, -0.5]]))
U = np.random.default_rng(0).normal(size=(200, 2))


def under(u: Array) -> Snapshots:
    return driven(TRUE, lambda k, _: u[k], len(u), np.ones(2))


GOOD = under(U)


def having(**changed: object) -> Snapshots:
    return Snapshots(**{**vars(GOOD), **changed})


def spoilt(array: Array, value: float) -> Array:
    array = array.copy()
    array[3, 1] = value
    return array
