"""The linear quadratic regulator of a linear model in discrete time: infinite and finite horizon.

The model has A (n, n) and B (n, m). Q weighs the state, R the control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel


@dataclass(frozen=True)
class Regulator:
    """u = -K z, with what proves it.

    Attributes:
        K: Gain (m, n).
        P: cost-to-go z^T P z (n, n).
        spectral_radius: Largest modulus of the poles of A - B K; below 1.
        residual: Largest entry of the discrete algebraic Riccati equation's residual, relative to that of P.
    """

    K: Array
    P: Array
    spectral_radius: float
    residual: float


def solve_lqr(model: LinearModel, Q: Array, R: Array) -> Regulator:
    """Return the stabilising regulator that minimises sum z^T Q z + u^T R u.

    Q (n, n) is symmetric and positive semi-definite, R (m, m) symmetric and positive definite.

    Raises:
        KoopmanError: the model cannot be stabilised, or Q leaves an undamped mode unseen.
    """
    A, B = model.A, model.B
    try:
        solution = solve_discrete_are(A, B, Q, R)
    except (LinAlgError, ValueError) as error:
        radius = np.abs(np.linalg.eigvals(A)).max()
        raise KoopmanError(
            f"no LQR for this model ({error}; spectral radius of A {radius:.3f}): excite all controls while recording"
        ) from None
    P: Array = np.asarray(0.5 * (solution + solution.T), dtype=np.float64)
    S = R + B.T @ P @ B
    K = np.asarray(np.linalg.solve(S, B.T @ P @ A), dtype=np.float64)
    residual = np.abs(A.T @ P @ A - P - A.T @ P @ B @ K + Q).max() / max(1.0, np.abs(P).max())
    radius = float(np.abs(np.linalg.eigvals(A - B @ K)).max())
    if radius >= 1.0:
        raise KoopmanError(f"the closed loop's spectral radius is {radius:.3f}: the model cannot be stabilised")
    return Regulator(K=K, P=P, spectral_radius=radius, residual=float(residual))


def finite_horizon(model: LinearModel, Q: Array, R: Array, z_ref: Array, iterations: int) -> tuple[Array, Array, Array]:
    """Return the first step's law u = k - K z after so many Riccati iterations (thesis Algorithm 1), and P.

    It minimises sum (z - z_ref)^T Q (z - z_ref) + u^T R u; k comes from the linear part of the cost-to-go, whose
    recursion begins with Q z_ref. The diagonals Q (n,) and R (m,) are not negative, and positive. K is (m, n), k (m,),
    P (n, n).
    """
    A, B = model.A, model.B
    P, v = np.diag(Q), Q * z_ref
    for _ in range(iterations):
        closed = A - B @ np.linalg.solve(np.diag(R) + B.T @ P @ B, B.T @ P @ A)
        v = closed.T @ v + Q * z_ref
        P = A.T @ P @ closed + np.diag(Q)
        P = 0.5 * (P + P.T)
    S = np.diag(R) + B.T @ P @ B
    K: Array = np.asarray(np.linalg.solve(S, B.T @ P @ A), dtype=np.float64)
    k: Array = np.asarray(np.linalg.solve(S, B.T @ v), dtype=np.float64)
    return K, k, P
