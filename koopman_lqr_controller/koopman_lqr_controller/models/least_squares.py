"""Unit-independent linear least squares: columns are scaled to similar size before any decision."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from koopman_lqr_controller.arrays import Array

EPS = float(np.finfo(np.float64).eps)
_RANK = 16.0 * EPS
"""Fraction of the largest singular value, times the root of the row count, below which a combination is rounding."""
_CONSTANT = 1e-13
"""Ratio of spread to size below which a column differs from its mean only by rounding."""


def sizes(X: Array) -> Array:
    """Return the root mean square of each column (p,); 1 for zero columns."""
    largest = np.abs(X).max(axis=0, initial=0.0)
    largest = np.where(largest > 0.0, largest, 1.0)
    return np.asarray(largest * np.maximum(np.sqrt(np.mean((X / largest) ** 2, axis=0)), EPS), dtype=np.float64)


@dataclass(frozen=True)
class Deviations:
    """Standardised columns: deviations from the mean, divided by the spread.

    Attributes:
        values: Columns of unit length (N, p); zeros for constant columns.
        spread: Standard deviation of each column (p,); 0 for constant columns.
        rounding: Maximum ratio of a column's rounding to its spread.
    """

    values: Array
    spread: Array
    rounding: float

    @classmethod
    def of(cls, X: Array, eps: float = EPS) -> Deviations:
        """Standardise columns (N, p) of precision `eps`."""
        size = sizes(X)
        around = X / size
        around = around - around.mean(axis=0)
        around = around - around.mean(axis=0)
        spread = np.sqrt(np.mean(around**2, axis=0))
        moves = spread > _CONSTANT
        unit = np.where(moves, spread, 1.0)
        values = np.where(moves, around / unit, 0.0) / np.sqrt(len(X))
        rounding = float((eps / unit[moves]).max(initial=eps))
        return cls(values, np.where(moves, spread * size, 0.0), rounding)


class LeastSquares:
    """Least squares of columns X (N, p) for any ridge, from one singular value decomposition of the scaled columns.

    For dependent columns, the solution has minimum norm in the scaled coordinates.

    Args:
        X: Regressors (N, p).

    Attributes:
        size: Root mean square of each column (p,).
        null: Combinations of the scaled columns that vanish (p, number of combinations).
    """

    def __init__(self, X: Array) -> None:
        self.size = sizes(X)
        self._moving = np.abs(X).max(axis=0, initial=0.0) > 0.0
        # Only the span of many rows matters: use a triangle with as many rows as columns.
        self._Q, self._R = np.linalg.qr(X / self.size)
        self._decompose(self._R, len(X))

    def _decompose(self, rows: Array, count: int) -> None:
        U, s, Vt = np.linalg.svd(rows, full_matrices=len(rows) < rows.shape[1])
        rank = int(
            np.count_nonzero(s > _RANK * np.sqrt(max(count, rows.shape[1])) * max(float(s.max(initial=0.0)), EPS))
        )
        self._U, self._s, self._V = U[: len(self._R), :rank], s[:rank], Vt[:rank].T * self._moving[:, None]
        self.null = np.asarray(Vt[rank:].T, dtype=np.float64)

    def ridged(self, weight: Array) -> LeastSquares:
        """Return the problem with a ridge of this weight on each scaled column (p,)."""
        problem = copy(self)
        problem._decompose(np.vstack((self._R, np.diag(weight))), len(self._Q))
        return problem

    def solve(self, Y: Array) -> Array:
        """Return the coefficients W (p, q) of X W = Y (N, q), in the units of X and Y."""
        scaled = self._V @ ((self._U.T @ (self._Q.T @ Y)) / self._s[:, None])
        return np.asarray(scaled / self.size[:, None], dtype=np.float64)

    def standard_errors(self, missed: Array, rounding: Array | float) -> Array:
        """Return the standard error of each coefficient (p, q), in the units of X and Y.

        Errors are infinite for dependent columns.

        Args:
            missed: Residual Y - X W (N, q).
            rounding: Rounding errors of Y's columns (q,), a lower bound of their uncertainty.
        """
        spare = max(len(missed) - len(self._s), 1)
        noise = np.maximum(sizes(missed) * missed.any(axis=0) * np.sqrt(len(missed) / spare), rounding)
        share = np.sqrt(np.sum((self._V / self._s) ** 2, axis=1)) / self.size
        share[np.abs(self.null).max(axis=1, initial=0.0) > np.sqrt(EPS)] = np.inf
        return np.asarray(share[:, None] * np.maximum(noise, np.finfo(float).tiny), dtype=np.float64)


def compressed(*blocks: Array) -> list[Array]:
    """Return columns with the same inner products as the given blocks, and at most as many rows as total columns."""
    joined = np.hstack(blocks)
    if len(joined) > joined.shape[1]:
        joined = np.asarray(np.linalg.qr(joined, mode="r"), dtype=np.float64)
    return np.split(joined, np.cumsum([block.shape[1] for block in blocks])[:-1], axis=1)
