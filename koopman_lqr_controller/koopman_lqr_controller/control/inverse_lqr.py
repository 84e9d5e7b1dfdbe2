"""Inverse LQR: diagonal Q and R whose infinite-horizon LQR is nearest to a given law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import minimize

from koopman_lqr_controller.arrays import Array, check_arrays, real_array
from koopman_lqr_controller.control.lqr_conditions import check_model
from koopman_lqr_controller.control.riccati import solve_lqr
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel

_LOG_RANGE = 14.0
_RESTRAINT = 1e-7
"""Regularisation weight of the squared logarithms, relative to the law's power; decides where data do not."""
_REFUSED = 1e6
"""Loss returned if no regulator exists, which turns the search back."""


@dataclass(frozen=True)
class LinearLaw:
    """A linear law u = -K z given by its weighted moments on data: E[w u u^T], E[w u z^T], E[w z z^T].

    Attributes:
        uu: Trace of E[w u u^T].
        uz: Matrix E[w u z^T] (m, n).
        zz: Matrix E[w z z^T] (n, n).
    """

    uu: float
    uz: Array
    zz: Array

    @classmethod
    def from_samples(cls, z: Array, u: Array, weight: Array) -> LinearLaw:
        """Create a law from samples z (N, n), u (N, m) with weights (N,), non-negative and not all zero.

        Raises:
            KoopmanError: Shapes or weights are invalid, or values are not finite.
        """
        z, u, weight = (real_array(name, it) for name, it in (("z", z), ("u", u), ("weight", weight)))
        shapes = {"z": (z, (len(weight), *z.shape[1:])), "u": (u, (len(weight), *u.shape[1:]))}
        check_arrays({**shapes, "weight": (weight, (len(weight),))}, "one row for each sample of the law")
        if (weight < 0.0).any() or not weight.any():
            raise KoopmanError("the samples of a law must have weights that are not negative, and one that is positive")
        share = (weight / weight.sum())[:, None]
        return cls(float((share * u * u).sum()), (share * u).T @ z, (share * z).T @ z)

    def mismatch(self, K: Array) -> float:
        """Return E[w |u + K z|^2] over E[w |u|^2]: 0 for the same law, 1 for K = 0."""
        return float((self.uu + 2.0 * np.sum(K * self.uz) + np.sum((K @ self.zz) * K)) / max(self.uu, 1e-12))

    def gradient(self, K: Array) -> Array:
        """Return the derivative of `mismatch` with respect to K (m, n)."""
        return 2.0 * (K @ self.zz + self.uz) / max(self.uu, 1e-12)


def mismatch_and_gradient(logs: Array, model: LinearModel, law: LinearLaw) -> tuple[float, Array]:
    """Return the mismatch of the LQR for costs exp(logs) to a law, and its derivative by the logarithms.

    The derivative of the cost-to-go P follows from the closed loop's Lyapunov equation; its adjoint is solved once.

    Args:
        logs: Logarithms of Q's and R's diagonals (n + m,).
        model: Linear model with A (n, n) and B (n, m).
        law: Target law.

    Raises:
        KoopmanError: No regulator exists.
    """
    A, B = model.A, model.B
    n = len(A)
    Q, R = np.exp(logs[:n]), np.exp(logs[n:])
    regulator = solve_lqr(model, np.diag(Q), np.diag(R))
    K, P = regulator.K, regulator.P
    closed = A - B @ K
    by_K = np.linalg.solve(np.diag(R) + B.T @ P @ B, law.gradient(K))
    by_P = B @ by_K @ closed.T
    adjoint = solve_discrete_lyapunov(closed, 0.5 * (by_P + by_P.T))
    by_Q = np.diag(adjoint)
    by_R = np.diag(K @ adjoint @ K.T) - np.sum(by_K * K, axis=1)
    return law.mismatch(K), np.concatenate((by_Q * Q, by_R * R))


def fit_costs(
    model: LinearModel, law: LinearLaw, Q: Array, R: Array, iterations: int = 150
) -> tuple[Array, Array, float]:
    """Fit Q (n,) and R (m,) to a law, and return them with the remaining mismatch.

    Args:
        model: Linear model with A (n, n) and B (n, m).
        law: Target law.
        Q: Initial values (n,), positive.
        R: Initial values (m,), positive.
        iterations: Maximum number of iterations of the search.

    Raises:
        KoopmanError: The model has no regulator for the initial costs, or the costs have invalid shapes or values.
    """
    A, B = check_model(model.A, model.B)
    n = len(A)
    Q, R = real_array("Q", Q), real_array("R", R)
    shapes = {"Q": (Q, (n,)), "R": (R, B.shape[1:]), "the law's E[w u z^T]": (law.uz, (B.shape[1], n))}
    check_arrays(shapes, "for the model it comes with")
    if (Q <= 0.0).any() or (R <= 0.0).any():
        raise KoopmanError("the costs to begin with must be positive: their logarithms are searched")
    begin = np.clip(np.log(np.concatenate((Q, R))), -_LOG_RANGE, _LOG_RANGE)
    mismatch_and_gradient(begin, model, law)  # raises if the model has no regulator

    def loss(logs: Array) -> tuple[float, Array]:
        try:
            value, gradient = mismatch_and_gradient(logs, model, law)
        except KoopmanError:
            return _REFUSED, np.zeros_like(logs)
        return value + _RESTRAINT * float(logs @ logs), gradient + 2.0 * _RESTRAINT * logs

    bounds = [(-_LOG_RANGE, _LOG_RANGE)] * len(begin)
    found = minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": iterations})
    logs = np.asarray(found.x, dtype=np.float64)
    try:
        value = mismatch_and_gradient(logs, model, law)[0]
    except KoopmanError:
        logs, value = begin, mismatch_and_gradient(begin, model, law)[0]
    return np.exp(logs[:n]), np.exp(logs[n:]), value
