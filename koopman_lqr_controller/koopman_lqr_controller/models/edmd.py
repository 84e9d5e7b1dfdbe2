"""Extended dynamic mode decomposition with control (thesis 2.3.1, Eq. 2.30-2.34)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.identifiability import (
    RegressionData,
    check_controls_told,
    check_no_drift,
    check_rows,
    check_states_told,
)
from koopman_lqr_controller.models.least_squares import Deviations, LeastSquares, sizes

_FADING = 0.999
"""Maximum modulus of a contracted model's poles."""
BEYOND_NOISE = 3.0
"""Number of standard errors beyond which a ridge's change of a coefficient is a bias rather than noise reduction."""
_FEW = 0.01
"""Tolerated ratio of standard error to coefficient size with hardly more rows than unknowns."""
BEARABLE = 0.5
"""Fraction of a control's effect that a ridge may hide, since an LQR stays stable with half of its gain."""


@dataclass(frozen=True)
class Snapshots:
    """Consecutive samples, equally spaced in time; rows need not come from one trajectory.

    Attributes:
        z: Psi(x_k) (N, n).
        u: Controls held between k and k + 1 (N, m).
        z_next: Psi(x_{k+1}) (N, n).
    """

    z: Array
    u: Array
    z_next: Array

    def __len__(self) -> int:
        return len(self.z)

    def __add__(self, other: Snapshots) -> Snapshots:
        return Snapshots(
            np.vstack((self.z, other.z)), np.vstack((self.u, other.u)), np.vstack((self.z_next, other.z_next))
        )

    def mirrored(self, z_sign: Array, u_sign: Array) -> Snapshots:
        """Return the snapshots with left and right swapped."""
        return Snapshots(self.z * z_sign, self.u * u_sign, self.z_next * z_sign)

    def centred(self, z_ref: Array, u_ref: Array) -> Snapshots:
        """Return the deviations from a reference."""
        return Snapshots(self.z - z_ref, self.u - u_ref, self.z_next - z_ref)


@dataclass(frozen=True)
class LinearModel:
    """z_{k+1} = A z_k + B u_k.

    Attributes:
        A: State matrix (n, n).
        B: Control matrix (n, m).
    """

    A: Array
    B: Array

    def predict(self, z: Array, u: Array) -> Array:
        """Return the next z for one (n,) or many (N, n)."""
        return z @ self.A.T + u @ self.B.T

    def contracted(self) -> tuple[float, LinearModel]:
        """Return a factor and the model with A times that factor, so that all modes are stable; 1 if already so."""
        radius = float(np.abs(np.linalg.eigvals(self.A)).max())
        factor = _FADING / radius if radius > _FADING else 1.0
        return factor, LinearModel(np.ascontiguousarray(factor * self.A), self.B)

    def one_step_error(self, data: Snapshots) -> Array:
        """Return the root mean square prediction error of each component (n,)."""
        return np.sqrt(np.mean((data.z_next - self.predict(data.z, data.u)) ** 2, axis=0))


def persistence_error(data: Snapshots) -> Array:
    """Return the one-step error of persistence (n,), the baseline of any model."""
    return np.sqrt(np.mean((data.z_next - data.z) ** 2, axis=0))


def fit(data: Snapshots, regularisation: float = 1e-3, lifted: bool = False) -> LinearModel:
    """Return the least-squares model, K = G^+ M of Eq. 2.34 with Psi(x, u) = [Psi(x), u].

    The model has no drift: z and u are deviations from a fixed point, or z contains the constant 1. The ridge reduces
    noise; if it would change the coefficients by more than noise can, as with simulated data, it is omitted.

    Args:
        data: Snapshots, at least n + m + 2 unless observables are linearly dependent.
        regularisation: Ridge relative to each regressor's variance; 0 is exactly Eq. 2.34.
        lifted: Whether z are lifting functions, which may be constant or redundant and leave a deterministic residual:
            A is then the minimum-norm solution, and the ridge is always applied.

    Raises:
        KoopmanError: The data is not finite, has inconsistent shapes, or does not identify A and B; names the columns.
    """
    if not (np.isfinite(regularisation) and regularisation >= 0.0):
        raise KoopmanError(f"the regularisation is {regularisation}: must be a number >= 0")
    given = RegressionData.of(data.z, data.u, data.z_next)
    if not lifted:
        check_rows(given)
    check_controls_told(given, lifted)
    if not lifted:
        check_states_told(given)
    Psi, n = np.hstack((given.z, given.u)), given.z.shape[1]
    spread, problem = Deviations.of(Psi).spread, LeastSquares(Psi)
    plain = problem.solve(given.z_next)
    ridge = np.sqrt(regularisation * len(Psi)) * spread / problem.size
    ridged = problem.ridged(ridge).solve(given.z_next)
    moved = row_sizes(ridged - plain, given.z_next)
    errors = problem.standard_errors(given.z_next - Psi @ plain, given.eps * sizes(given.z_next))
    biased = moved > BEYOND_NOISE * row_sizes(errors, given.z_next)
    if not lifted:
        check_no_drift(given, plain)
        _check_enough(errors, plain, given)
        W = plain if biased.any() else ridged
    elif (biased & (moved > BEARABLE * row_sizes(plain, given.z_next)))[n:].any():
        raise KoopmanError(
            f"controls vary so little apart from the state that a ridge of {regularisation:g} hides what they do: add "
            "a larger dither of its own to each control while recording"
        )
    else:
        W = ridged
    if not np.isfinite(W).all():
        raise KoopmanError("A and B are too large for their units: give z and u in units nearer to what they hold")
    return LinearModel(A=np.ascontiguousarray(W[:n].T), B=np.ascontiguousarray(W[n:].T))


def _check_enough(errors: Array, W: Array, data: RegressionData) -> None:
    """Raise if there are hardly more rows than unknowns and noise dominates, which makes even errors unreliable."""
    few = len(data.z) < 2 * len(W)
    if few and np.linalg.norm(row_sizes(errors, data.z_next)) > _FEW * np.linalg.norm(row_sizes(W, data.z_next)):
        raise KoopmanError(
            f"{len(data.z)} snapshots are too few for {len(W)} observables and controls with such noise: record at "
            f"least {2 * len(W)}, better ten times as many"
        )


def row_sizes(W: Array, Y: Array) -> Array:
    """Return the size of the coefficients of each regressor (p,), with outputs in units of their own size."""
    return np.asarray(np.linalg.norm(W / sizes(Y), axis=1), dtype=np.float64)
