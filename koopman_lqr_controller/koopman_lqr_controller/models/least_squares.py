"""Linear least squares in which units do not matter: columns are brought to like size before anything is decided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from koopman_lqr_controller.arrays import Array

EPS = float(np.finfo(np.float64).eps)
_RANK = 16.0 * EPS
"""Share of the largest singular value, times the root of the rows, below which a combination is rounding."""
_CONSTANT = 1e-13
"""Spread over size below which a column differs from its mean by rounding alone."""


def sizes(X: Array) -> Array:
    """Return the root mean square of each column (p,); 1 where a column is zero."""
    largest = np.abs(X).max(axis=0, initial=0.0)
    largest = np.where(largest > 0.0, largest, 1.0)
    return np.asarray(largest * np.maximum(np.sqrt(np.mean((X / largest) ** 2, axis=0)), EPS), dtype=np.float64)


@dataclass(frozen=True)
class Deviations:
    """Columns around their means, over their spreads.

    Attributes:
        values: Columns of unit length (N, p); zeros where a column is constant.
        spread: Standard deviation of each column (p,); 0 where it is constant.
        rounding: Largest share of a spread that is the rounding of its column.
    """

    values: Array
    spread: Array
    rounding: float

    @classmethod
    def of(cls, X: Array, eps: float = EPS) -> Deviations:
        """Return those of columns (N, p) whose numbers have the precision `eps`."""
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

    Where columns repeat each other the solution is the smallest in these scaled coordinates.

    Args:
        X: Regressors (N, p).
        weight: Size of the ridge on each scaled column (p,); None for no ridge.

    Attributes:
        size: Root mean square of each column (p,).
        null: Combinations of the scaled columns that are zero throughout (p, those).
    """

    def __init__(self, X: Array, weight: Array | None = None) -> None:
        self.size = sizes(X)
        rows = X / self.size
        if weight is not None:
            rows = np.vstack((rows, np.diag(weight)))
        U, s, Vt = np.linalg.svd(rows, full_matrices=True) if len(rows) < rows.shape[1] else _thin_svd(rows)
        rank = int(np.count_nonzero(s > _RANK * np.sqrt(max(rows.shape)) * max(float(s[0]), EPS))) if len(s) else 0
        self._U, self._s, self._V = U[: len(X), :rank], s[:rank], Vt[:rank].T * (np.abs(X).max(axis=0) > 0.0)[:, None]
        self.null = np.asarray(Vt[rank:].T, dtype=np.float64)

    def solve(self, Y: Array) -> Array:
        """Return the coefficients W (p, q) of X W = Y (N, q), in the units of X and Y."""
        scaled = self._V @ ((self._U.T @ Y) / self._s[:, None])
        return np.asarray(scaled / self.size[:, None], dtype=np.float64)

    def standard_errors(self, missed: Array, rounding: Array | float) -> Array:
        """Return the standard error of each coefficient (p, q), in the units of X and Y.

        They are infinite for columns that repeat others.

        Args:
            missed: Y - X W (N, q).
            rounding: Rounding of Y's columns (q,): they are not known better.
        """
        spare = max(len(missed) - len(self._s), 1)
        noise = np.maximum(sizes(missed) * missed.any(axis=0) * np.sqrt(len(missed) / spare), rounding)
        share = np.sqrt(np.sum((self._V / self._s) ** 2, axis=1)) / self.size
        share[np.abs(self.null).max(axis=1, initial=0.0) > np.sqrt(EPS)] = np.inf
        return np.asarray(share[:, None] * np.maximum(noise, np.finfo(float).tiny), dtype=np.float64)


def _thin_svd(X: Array) -> tuple[Array, Array, Array]:
    U, s, Vt = np.linalg.svd(X, full_matrices=False)
    return U, s, Vt
