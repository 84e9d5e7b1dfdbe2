"""Conditions of a linear quadratic regulator on A, B, Q and R: valid costs, stabilisable and detectable modes.

A regulator exists if each mode with |pole| >= 1 is affected by a control (stabilisable) and appears in the cost
(detectable), by the Popov-Belevitch-Hautus tests. All tests use balanced units, see `Units.balancing`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koopman_lqr_controller.arrays import Array, check_arrays, check_size, real_array
from koopman_lqr_controller.errors import KoopmanError

_SYMMETRIC = 1e-8
"""Asymmetry of a cost attributed to rounding, relative to its entries."""
_DEFINITE = 1e-12
"""Eigenvalue of a cost, scaled to a unit diagonal, that counts as 0."""
_UNDAMPED = 1.0 - 1e-10
"""Modulus from which a mode counts as undamped."""
_UNREACHED = 1e-15
"""Distance of [p I - A, B] from losing rank, relative to its size, attributed to rounding."""


def check_model(A: ArrayLike, B: ArrayLike) -> tuple[Array, Array]:
    """Validate A (n, n) and B (n, m) and return them as float64.

    Raises:
        KoopmanError: Shapes are invalid, there is no state or control, or values are not finite.
    """
    A, B = real_array("A", A), real_array("B", B)
    if B.ndim != 2 or not B.size:
        raise KoopmanError(f"B has shape {B.shape}: must have one row per state and a column for each control")
    check_arrays({"A": (A, (len(B), len(B))), "B": (B, B.shape)}, "for the B it comes with")
    check_size("A", A)
    check_size("B", B)
    return A, B


def check_cost(name: str, weight: ArrayLike, size: int, positive: bool) -> Array:
    """Validate a cost (size, size), and symmetrise it if it is asymmetric only by rounding.

    Args:
        name: Name of the cost in messages.
        weight: Cost matrix.
        size: Required number of rows.
        positive: Whether the cost must be positive definite rather than semi-definite.

    Raises:
        KoopmanError: The cost has the wrong shape, is not finite, not symmetric, or not definite as required.
    """
    cost = real_array(name, weight)
    if cost.shape == (size,):
        raise KoopmanError(f"{name} has shape {cost.shape}, must have {(size, size)}: give np.diag({name})")
    check_arrays({name: (cost, (size, size))}, "for the model it comes with")
    check_size(name, cost)
    diagonal, largest = np.diag(cost), float(np.abs(cost).max())
    if (diagonal < -_DEFINITE * largest).any() or (positive and (diagonal <= 0.0).any()):
        index = int(diagonal.argmin())
        wanted = "positive definite: each control must cost something" if positive else "positive semi-definite"
        raise KoopmanError(f"{name}[{index}, {index}] is {diagonal[index]:g}: {name} must be {wanted}")
    unit = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    alike = np.where(np.outer(diagonal > 0.0, diagonal > 0.0), cost / np.outer(unit, unit), cost / max(largest, 1e-300))
    if np.abs(alike - alike.T).max() > _SYMMETRIC:
        raise KoopmanError(f"{name} is not symmetric: give 0.5 * ({name} + {name}.T), which costs the same")
    cost, alike = 0.5 * (cost + cost.T), 0.5 * (alike + alike.T)
    least = float(np.linalg.eigvalsh(alike).min())
    if positive and least <= _DEFINITE:
        raise KoopmanError(
            f"{name} is not positive definite (least eigenvalue {least:.1e} with a diagonal of 1): raise its diagonal"
        )
    if least < -_SYMMETRIC and float(np.linalg.eigvalsh(cost).min()) < -_DEFINITE * size * largest:
        raise KoopmanError(
            f"{name} is not positive semi-definite (least eigenvalue {least:.1e} with a diagonal of 1): raise its "
            "diagonal, or lower what is beside it"
        )
    return np.asarray(cost, dtype=np.float64)


def check_modes(A: Array, B: Array, Q: Array) -> None:
    """Raise if an undamped mode is not affected by any control, or does not appear in the cost.

    A (n, n), B (n, m) and Q (n, n) are in balanced units.

    Raises:
        KoopmanError: Names the mode by its pole and the states involved.
    """
    poles = np.linalg.eigvals(A)
    undamped = [pole for pole in poles[np.abs(poles) >= _UNDAMPED] if pole.imag >= 0.0]
    if not undamped:
        return
    n = len(A)
    unseen = float(np.linalg.eigvalsh(Q / max(float(np.abs(Q).max()), 1e-300)).min()) < _SYMMETRIC
    root = _root(Q) if unseen else Q
    B = B / max(float(np.abs(B).max()), 1e-300)
    for pole in undamped:
        away = pole * np.eye(n) - A
        size = max(float(np.linalg.norm(away, 2)), 1.0)
        U, reached, _ = np.linalg.svd(np.hstack((away, size * B)))
        if reached[n - 1] <= _UNREACHED * n * size:
            raise KoopmanError(
                f"no LQR for this model, as it cannot be stabilised: no control moves the mode "
                f"{_told(pole, U[:, n - 1])}; excite all controls while recording, add a control, or take that mode out"
            )
        if unseen:
            _, seen, V = np.linalg.svd(np.vstack((away, size * root)))
            if seen[n - 1] <= _UNREACHED * n * size:
                raise KoopmanError(
                    f"Q does not see the mode {_told(pole, V[n - 1])}, which does not fade by itself: give these "
                    "states a weight in Q, or take that mode out of the model"
                )


def _root(Q: Array) -> Array:
    """Return C with C^T C = Q, relative to Q's size."""
    values, directions = np.linalg.eigh(Q / max(float(np.abs(Q).max()), 1e-300))
    kept = np.where(values > 1e-14, values, 0.0)
    return np.asarray((directions * np.sqrt(kept)).T, dtype=np.float64)


def _told(pole: complex, direction: NDArray[np.complex128]) -> str:
    """Describe a mode by its pole and the states most involved."""
    part = np.abs(direction)
    states = [str(index) for index in np.argsort(-part)[:4] if part[index] > 0.3 * part.max()]
    number = f"{pole.real:.6g}" if pole.imag == 0.0 else f"{pole.real:.4g} +- {pole.imag:.4g}i"
    return f"at the pole {number} ({'state' if len(states) == 1 else 'states'} {', '.join(states)})"
