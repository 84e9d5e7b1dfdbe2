"""Fewer latent dimensions: projections C (r, n) with orthonormal rows, z = C psi, in two families.

What a law will ask for along a model psi_{k+1} = A psi_k + ... depends on psi through K psi, K A psi, K A^2 psi and so
on. `observed` keeps the first of these, so that the model that is left predicts what the law needs; `principal` keeps
what varies most, whether the law needs it or not.
"""

from __future__ import annotations

import numpy as np

from koopman_lqr_controller.arrays import Array

_NEW = 1e-6
"""Part of a row that is not in the span of those before it, below which it adds only rounding."""


def observed(K: Array, A: Array, size: int) -> Array:
    """Return the first `size` directions of the rows of K, K A, K A^2, ... (at most size, n), by Arnoldi's process.

    Args:
        K: Gain (m, n).
        A: State matrix of the model (n, n).
        size: At most so many; fewer where the rows span no more.
    """
    found = np.zeros((0, A.shape[0]))
    rows = list(K)
    while rows and len(found) < size:
        row = rows.pop(0)
        length = np.linalg.norm(row)
        for _ in range(2):  # once more takes away what rounding left
            row = row - found.T @ (found @ row)
        left = np.linalg.norm(row)
        if left > _NEW * length:
            found = np.vstack((found, row / left))
            rows.append(found[-1] @ A)
    return found


def principal(deviations: Array, least: float) -> Array:
    """Return the directions of deviations (N, n), those that vary most first (at most n, n).

    Args:
        deviations: Deviations from a reference (N, n).
        least: A direction that varies by less than this part of the first says nothing, and is left out.
    """
    _, spread, directions = np.linalg.svd(deviations, full_matrices=False)
    return np.ascontiguousarray(directions[spread > least * spread[0]])
