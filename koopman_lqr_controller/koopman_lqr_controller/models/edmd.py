"""Extended dynamic mode decomposition with control (thesis 2.3.1, Eq. 2.30-2.34)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError

_FADING = 0.999
"""Largest modulus of a model that was contracted."""


@dataclass(frozen=True)
class Snapshots:
    """Consecutive samples, equally spaced in time; rows need not come from one trajectory.

    Attributes:
        z: Psi(x_k) (N, n).
        u: Controls held from k to k + 1 (N, m).
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
        """Return what would have been seen had left and right been swapped."""
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
        """Return a factor, and the same with A times it, so that all modes fade; 1 where they do already."""
        factor = min(1.0, _FADING / float(np.abs(np.linalg.eigvals(self.A)).max()))
        return factor, LinearModel(np.ascontiguousarray(factor * self.A), self.B)

    def one_step_error(self, data: Snapshots) -> Array:
        """Return the root mean square prediction error of each component (n,)."""
        return np.sqrt(np.mean((data.z_next - self.predict(data.z, data.u)) ** 2, axis=0))


def persistence_error(data: Snapshots) -> Array:
    """Return the one-step error of "nothing changes" (n,): what any model must beat."""
    return np.sqrt(np.mean((data.z_next - data.z) ** 2, axis=0))


def fit(data: Snapshots, regularisation: float = 1e-3) -> LinearModel:
    """Return the least-squares model, K = G^+ M of Eq. 2.34 with Psi(x, u) = [Psi(x), u].

    The ridge is relative to each regressor's variance; 0 is Eq. 2.34 to the letter. There are n + m rows at least.

    Raises:
        KoopmanError: too few rows, or values that are not finite.
    """
    Psi = np.hstack((data.z, data.u))
    if len(data) < Psi.shape[1]:
        raise KoopmanError(f"{len(data)} snapshots are too few for {Psi.shape[1]} observables: record a longer drive")
    if not (np.isfinite(Psi).all() and np.isfinite(data.z_next).all()):
        raise KoopmanError("snapshots hold values that are not finite")
    G = Psi.T @ Psi / len(data)
    M = Psi.T @ data.z_next / len(data)
    K = np.linalg.pinv(G + regularisation * np.diag(Psi.var(axis=0)), hermitian=True) @ M
    n = data.z.shape[1]
    return LinearModel(A=np.ascontiguousarray(K[:n].T), B=np.ascontiguousarray(K[n:].T))
