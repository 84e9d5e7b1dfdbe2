"""Least squares for scarce and noisy data: a linear model shrunk towards persistence.

The usual ridge shrinks A towards zero, which predicts worse than persistence on little data. This one shrinks towards A
= I, B = 0. Its strength is chosen by cross-validation over parts of the drive: the strongest one that is not clearly
worse than the best (within one standard error).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import BEARABLE, BEYOND_NOISE, LinearModel, Snapshots, row_sizes
from koopman_lqr_controller.models.identifiability import RegressionData, check_controls_move, check_controls_told
from koopman_lqr_controller.models.least_squares import Deviations, LeastSquares

RIDGES = (0.0, *(float(10.0**power) for power in np.arange(-6.0, 2.1, 1.0 / 3.0)))
"""Strengths to try, relative to each regressor's variance; 0 for noise-free data."""
_ROUNDING = 1e-13
"""Fraction of the largest singular value below which a direction is only rounding."""
_FOLDS = 8


@dataclass(frozen=True)
class ShrinkageFit:
    """A model z_{k+1} = drift + A z_k + B u_k, with details of its selection.

    Attributes:
        model: Linear model with A (n, n) and B (n, m).
        drift: Drift of the model (n,).
        ridge: Strength of the shrinkage.
        cross_validation_error: Cross-validated error relative to persistence.
    """

    model: LinearModel
    drift: Array
    ridge: float
    cross_validation_error: float


def fit_with_shrinkage(
    data: Snapshots, twin: Snapshots | None = None, drift: bool = True, lifted: bool = False
) -> ShrinkageFit:
    """Fit a shrunk model to snapshots in time order; consecutive snapshots are held out together.

    Args:
        data: Snapshots in the order of time.
        twin: As many additional snapshots, e.g. mirrored ones; each is held out together with its counterpart.
        drift: Whether the model has a drift; otherwise it describes deviations from a fixed point.
        lifted: Whether z are lifting functions with a deterministic residual, as in `fit`.

    Raises:
        KoopmanError: There are fewer than two rows per part, values are not finite or have inconsistent shapes, nothing
            moves, or the data does not identify the effect of the controls.
    """
    given = RegressionData.of(data.z, data.u, data.z_next)
    if len(given.z) < 2 * _FOLDS:
        raise KoopmanError(f"{len(given.z)} steps are too few to choose a model by: record a longer drive")
    if not (given.z_next - given.z).any():
        raise KoopmanError("nothing changes in this drive: record one in which the robot moves")
    check_controls_move(given.u)  # a twin would make a constant control appear to move
    parts = [[rows] for rows in np.array_split(np.arange(len(data)), _FOLDS)]
    if twin is not None:
        RegressionData.of(twin.z, twin.u, twin.z_next).check_like(given)
        parts = [[rows, rows + len(data)] for (rows,) in parts]
        data = data + twin
        given = RegressionData.of(data.z, data.u, data.z_next)
    check_controls_told(given, lifted)
    X, Y = np.hstack((given.z, given.u)), given.z_next - given.z
    middle, moved = (X.mean(axis=0), Y.mean(axis=0)) if drift else (np.zeros(X.shape[1]), np.zeros(Y.shape[1]))
    unit = Deviations.of(X).spread
    unit[unit == 0.0] = 1.0
    X, Y = (X - middle) / unit, Y - moved
    errors = _cross_validation_errors(X, Y, moved, [np.concatenate(part) for part in parts])
    chosen = _chosen(errors)
    n = given.z.shape[1]
    chosen = _bearable(X, Y, chosen, n)
    W = _solutions(X, Y, RIDGES[chosen : chosen + 1])[0].T / unit
    A = np.eye(n) + W[:, :n]
    if not drift:
        # What stays at the fixed point is uninformative; A = I would create an uncontrollable mode there.
        still = ~(X[:, :n].any(axis=0) | Y.any(axis=0))
        A[still, still] = 0.0
    model = LinearModel(A, np.ascontiguousarray(W[:, n:]))
    return ShrinkageFit(model, moved - W @ middle, RIDGES[chosen], float(np.sqrt(errors[:, chosen].mean())))


def _cross_validation_errors(X: Array, Y: Array, moved: Array, parts: Sequence[NDArray[np.intp]]) -> Array:
    """Return squared errors relative to persistence (parts, ridges), with each part predicted from the others."""
    out = []
    for rows in parts:
        x, y = X[rows], Y[rows]
        found = _solutions(np.delete(X, rows, axis=0), np.delete(Y, rows, axis=0), RIDGES)
        still = max(float(np.sum((y + moved) ** 2)), np.finfo(float).tiny)
        out.append([np.sum((y - x @ W) ** 2) / still for W in found])
    return np.array(out)


def _chosen(errors: Array) -> int:
    """Return the strongest ridge whose error is within a standard error of the best one's, part by part."""
    best = int(errors.mean(axis=0).argmin())
    excess = errors - errors[:, [best]]
    allowed = excess.std(axis=0, ddof=1) / np.sqrt(len(errors))
    return int(np.flatnonzero(excess.mean(axis=0) <= allowed).max())


def _bearable(X: Array, Y: Array, chosen: int, n: int) -> int:
    """Return the strongest ridge, up to the chosen one, that hides no identifiable effect of a control.

    A control that mostly follows the state has a small independent part, and small parts are shrunk first. The
    regressors after the first n are the controls.
    """
    plain, *ridged = _solutions(X, Y, (0.0, *RIDGES[: chosen + 1]))
    problem = LeastSquares(X)
    errors = row_sizes(problem.standard_errors(Y - X @ plain, 0.0), Y)[n:]
    known = row_sizes(plain, Y)[n:]
    for index in range(chosen, 0, -1):
        hidden = row_sizes(ridged[index] - plain, Y)[n:]
        if not ((hidden > BEARABLE * known) & (hidden > BEYOND_NOISE * errors)).any():
            return index
    return 0


def _solutions(X: Array, Y: Array, ridges: Sequence[float]) -> list[Array]:
    """Return the coefficients for each ridge, from one decomposition of X; X^T X would lose half of the digits."""
    U, s, Vt = np.linalg.svd(X, full_matrices=False)
    s = s[s > _ROUNDING * s[0]]
    along, V = U[:, : len(s)].T @ Y, Vt[: len(s)].T * (np.abs(X).max(axis=0) > 0.0)[:, None]
    return [np.asarray(V @ ((s / (s**2 + ridge * len(X)))[:, None] * along), dtype=np.float64) for ridge in ridges]
