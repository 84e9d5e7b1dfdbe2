"""Balances the units of a linear quadratic problem, so that its entries have similar size and rounding is harmless."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, solve_discrete_are, solve_discrete_lyapunov

from koopman_lqr_controller.arrays import Array

_FARTHEST = 400.0
"""Maximum exponent (of two) by which a unit may change."""
_FREE = 1e-8
"""Cost of a state relative to the controls' below which it counts as free."""


@dataclass(frozen=True)
class LqrProblem:
    """The problem to minimise sum z^T Q z + u^T R u for z_{k+1} = A z_k + B u_k.

    Attributes:
        A: State matrix (n, n).
        B: Control matrix (n, m).
        Q: Cost of the state (n, n).
        R: Cost of the control (m, m).
    """

    A: Array
    B: Array
    Q: Array
    R: Array

    def gain(self, P: Array) -> Array:
        """Return K (m, n) for the cost-to-go P (n, n)."""
        A, B = self.A, self.B
        return np.asarray(np.linalg.solve(self.R + B.T @ P @ B, B.T @ P @ A), dtype=np.float64)

    def solution(self) -> Array | None:
        """Return the stabilising P (n, n) of the Riccati equation; None if rounding prevents a solution."""
        try:
            solution = solve_discrete_are(self.A, self.B, self.Q, self.R)
            P: Array = np.asarray(0.5 * (solution + solution.T), dtype=np.float64)
            return P if self._damps(self.gain(P)) else None
        except (LinAlgError, ValueError):
            return None

    def _damps(self, K: Array) -> bool:
        """Return whether all poles of A - B K lie inside the unit circle."""
        return bool(np.isfinite(K).all() and np.abs(np.linalg.eigvals(self.A - self.B @ K)).max() < 1.0)

    def residual(self, P: Array) -> float:
        """Return the largest entry of the Riccati equation's residual, relative to that of P.

        If the cost of states is negligible compared with the controls', the residual is relative to the latter.
        """
        if not np.isfinite(P).all():
            return float("inf")
        left = np.abs(self.A.T @ P @ (self.A - self.B @ self.gain(P)) - P + self.Q).max()
        size = max(float(np.abs(P).max()), _FREE * float(np.abs(self.R).max()))
        return float(left / size) if np.isfinite(left) else float("inf")

    def refined(self, P: Array) -> Array:
        """Return P after a step of Newton's method (Hewer 1971), if that reduces the residual."""
        K = self.gain(P)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LinAlgWarning)  # the residual is checked below
                better = solve_discrete_lyapunov((self.A - self.B @ K).T, self.Q + K.T @ self.R @ K)
        except (LinAlgError, ValueError):
            return P
        symmetric: Array = np.asarray(0.5 * (better + better.T), dtype=np.float64)
        return symmetric if self.residual(symmetric) < self.residual(P) else P


@dataclass(frozen=True)
class Units:
    """Units d (n,) of states and e (m,) of controls, all powers of two, so that scaling is exact."""

    d: Array
    e: Array

    @classmethod
    def balancing(cls, problem: LqrProblem) -> Units:
        """Return units that bring all entries of a problem near to 1.

        They minimise the squared logarithms of the nonzero entries of D^-1 A D, D^-1 B E, and of the roots of the
        diagonals of D Q D and E R E over one unit of the cost (Curtis and Reid 1972), which makes the result
        independent of the given units.
        """
        n, m = problem.B.shape
        links = np.zeros((n + m + 1, n + m + 1))  # edges from columns to rows; the last node is the cost
        links[:n, :-1] = np.abs(np.hstack((problem.A, problem.B)))
        links[-1, :-1] = np.sqrt(np.maximum(np.concatenate((np.diag(problem.Q), np.diag(problem.R))), 0.0))
        np.fill_diagonal(links, 0.0)
        linked = links > 0.0
        logs = np.log2(np.where(linked, links, 1.0))
        degree = linked.sum(axis=0) + linked.sum(axis=1)
        equations = np.diag(degree) - linked.astype(np.float64) - linked.T
        powers = np.linalg.lstsq(equations, logs.sum(axis=1) - logs.sum(axis=0), rcond=1e-12)[0]
        powers = np.exp2(np.clip(np.round(powers), -_FARTHEST, _FARTHEST))
        return cls(powers[:n] / powers[-1], powers[n:-1] / powers[-1])

    def of(self, problem: LqrProblem) -> LqrProblem:
        """Convert a problem to these units."""
        d, e = self.d, self.e
        A, B = problem.A * d / d[:, None], problem.B * e / d[:, None]
        return LqrProblem(A, B, problem.Q * np.outer(d, d), problem.R * np.outer(e, e))

    def cost_to_go(self, P: Array) -> Array:
        """Return P (n, n) of the problem in these units."""
        return P * np.outer(self.d, self.d)

    def back(self, P: Array) -> Array:
        """Convert P (n, n) back to the units of the given problem."""
        return P / np.outer(self.d, self.d)
