"""The linear quadratic regulator of a linear model in discrete time: infinite and finite horizon.

The model has A (n, n) and B (n, m). Q weighs the state, R the control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.lqr_conditions import check_cost, check_model, check_modes
from koopman_lqr_controller.control.scaling import LqrProblem, Units
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel

_EXACT = 1e-10
"""Residual of the Riccati equation in balanced units, relative to P, attributed to rounding."""
_BORNE = 1e-6
"""Maximum tolerated residual, at which K is accurate to about as many digits."""


@dataclass(frozen=True)
class Regulator:
    """The law u = -K z, with evidence of its validity.

    Attributes:
        K: Gain (m, n).
        P: Cost-to-go z^T P z (n, n).
        spectral_radius: Largest modulus of the poles of A - B K; below 1.
        residual: Largest entry of the discrete algebraic Riccati equation's residual, relative to that of P.
    """

    K: Array
    P: Array
    spectral_radius: float
    residual: float


def solve_lqr(model: LinearModel, Q: Array, R: Array) -> Regulator:
    """Return the stabilising regulator that minimises sum z^T Q z + u^T R u.

    Q (n, n) is symmetric and positive semi-definite, R (m, m) symmetric and positive definite. The result does not
    depend on units: if rounding would spoil the solution in the given units, balanced ones are used.

    Raises:
        KoopmanError: A matrix has the wrong shape, is not finite or is not a valid cost; an undamped mode is not
            controllable or not in the cost (the message names it); or rounding prevents a solution.
    """
    A, B = check_model(model.A, model.B)
    Q, R = check_cost("Q", Q, len(A), positive=False), check_cost("R", R, B.shape[1], positive=True)
    problem = LqrProblem(A, B, Q, R)
    units = Units.balancing(problem)
    balanced = units.of(problem)
    check_modes(balanced.A, balanced.B, balanced.Q)
    P = _solution(problem, balanced, units)
    K = problem.gain(P)
    residual = np.abs(A.T @ P @ A - P - A.T @ P @ B @ K + Q).max() / max(1.0, np.abs(P).max())
    radius = float(np.abs(np.linalg.eigvals(A - B @ K)).max())
    if not radius < 1.0:
        raise KoopmanError(f"the closed loop's spectral radius is {radius:.3f}: the model cannot be stabilised")
    return Regulator(K=K, P=P, spectral_radius=radius, residual=float(residual))


def _solution(problem: LqrProblem, balanced: LqrProblem, units: Units) -> Array:
    """Return the cost-to-go P (n, n), solved in the given units if exact, else in balanced units.

    Raises:
        KoopmanError: There is no solution, or only an inexact one.
    """
    P = problem.solution()
    left = float("inf") if P is None else balanced.residual(units.cost_to_go(P))
    if left > _EXACT:
        found = balanced.solution()
        if found is not None:
            found = balanced.refined(found)
            if balanced.residual(found) < left:
                P, left = units.back(found), balanced.residual(found)
    if P is None:
        radius = np.abs(np.linalg.eigvals(problem.A)).max()
        raise KoopmanError(
            f"no LQR for this model (spectral radius of A {radius:.3f}): excite all controls while recording, or give "
            "weights that are less far apart"
        )
    if left > _BORNE:
        raise KoopmanError(
            f"the Riccati equation of this model is solved to {left:.0e} only: its poles, or the weights of Q and R, "
            "are too far apart; bring them nearer"
        )
    return P


def finite_horizon(model: LinearModel, Q: Array, R: Array, z_ref: Array, iterations: int) -> tuple[Array, Array, Array]:
    """Return the first law u = k - K z after a number of Riccati iterations (thesis Algorithm 1), and P.

    The law minimises sum (z - z_ref)^T Q (z - z_ref) + u^T R u; k comes from the linear part of the cost-to-go, whose
    recursion starts with Q z_ref. The diagonals Q (n,) are non-negative, and R (m,) positive. K is (m, n), k (m,), P
    (n, n).

    Raises:
        KoopmanError: The costs of this many steps overflow.
    """
    A, B = model.A, model.B
    P, v = np.diag(Q), Q * z_ref
    for _ in range(iterations):
        closed = A - B @ _solve(np.diag(R) + B.T @ P @ B, B.T @ P @ A)
        v = closed.T @ v + Q * z_ref
        P = A.T @ P @ closed + np.diag(Q)
        P = 0.5 * (P + P.T)
    S = np.diag(R) + B.T @ P @ B
    return _solve(S, B.T @ P @ A), _solve(S, B.T @ v), P


def _solve(S: Array, Y: Array) -> Array:
    try:
        X = np.asarray(np.linalg.solve(S, Y), dtype=np.float64)
    except np.linalg.LinAlgError:
        X = np.full(Y.shape, np.inf)
    if not np.isfinite(X).all():
        raise KoopmanError("the gain of this model is not finite: its modes grow too fast for so many iterations")
    return X
