"""Linear control in a learnt latent space (thesis Eq. 4.8, 4.9), as it runs on the robot: NumPy only.

The gain is not stored: it follows from A, B, Q, R when a policy is made, so that none can differ from its own model.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koopman_lqr_controller.edmd import LinearModel
from koopman_lqr_controller.encoder import Encoder
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.riccati import finite_horizon, solve_lqr

Array = NDArray[np.float64]

SATURATIONS = ("tanh", "clip")


@dataclass(frozen=True)
class LatentController:
    """u = k - K z with z = C psi(x), and the action is u brought into [-1, 1].

    With a `horizon` the gain is that of Algorithm 1 after so many iterations, k follows the reference, and the model is
    one of z: what learning optimises. Without, it is the regulator of the infinite horizon and the model is one of
    deviations from z_ref and u_ref, with k = u_ref + K z_ref: what consolidation makes.

    Attributes:
        encoder: psi.
        model: A (n, n), B (n, m).
        Q: diagonal of the state cost (n,).
        R: diagonal of the control cost (m,).
        z_ref: goal (n,); zeros where there is none.
        u_ref: what holds it there (m,), before saturation; zeros unless given. Only for the infinite horizon.
        horizon: Riccati iterations; None for infinitely many.
        saturation: "tanh", as learnt, or "clip".
        projection: C (n, encoder's n), None for the identity: a reduced latent space.
        K: gain (m, n).
        k: offset (m,).
        P: cost-to-go (n, n).
        spectral_radius: of A - B K.
        residual: of the algebraic Riccati equation, relative; infinite with a finite horizon.
    """

    encoder: Encoder
    model: LinearModel
    Q: Array
    R: Array
    z_ref: Array
    horizon: int | None = None
    saturation: str = "tanh"
    projection: Array | None = None
    u_ref: Array | None = None
    K: Array = field(init=False)
    k: Array = field(init=False)
    P: Array = field(init=False)
    spectral_radius: float = field(init=False)
    residual: float = field(init=False)

    def __post_init__(self) -> None:
        if self.u_ref is None:
            object.__setattr__(self, "u_ref", np.zeros(len(self.R)))
        self._check()
        if self.horizon is None:
            regulator = solve_lqr(self.model, np.diag(self.Q), np.diag(self.R))
            K, P, k = regulator.K, regulator.P, self._u_ref + regulator.K @ self.z_ref
            radius, residual = regulator.spectral_radius, regulator.residual
        else:
            K, k, P = finite_horizon(self.model, self.Q, self.R, self.z_ref, self.horizon)
            radius = float(np.abs(np.linalg.eigvals(self.model.A - self.model.B @ K)).max())
            residual = float("inf")
        for name, value in (("K", K), ("k", k), ("P", P), ("spectral_radius", radius), ("residual", residual)):
            object.__setattr__(self, name, value)

    def _check(self) -> None:
        n, m = self.model.B.shape if self.model.B.ndim == 2 else (0, 0)
        shapes = {
            "A": (self.model.A, (n, n)),
            "B": (self.model.B, (n, m)),
            "Q": (self.Q, (n,)),
            "R": (self.R, (m,)),
            "z_ref": (self.z_ref, (n,)),
            "u_ref": (self._u_ref, (m,)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise KoopmanError(f"{name} has shape {array.shape}, must have {shape} for the B it comes with")
            if not np.isfinite(array).all():
                raise KoopmanError(f"{name} holds values that are not finite")
        if (self.Q < 0.0).any() or (self.R <= 0.0).any():
            raise KoopmanError("Q must not be negative, and R must be positive")
        if self.horizon is not None and (self.horizon < 1 or self._u_ref.any()):
            raise KoopmanError(f"horizon is {self.horizon}: must be at least 1 and without u_ref, or null for infinity")
        if self.saturation not in SATURATIONS:
            raise KoopmanError(f"saturation is '{self.saturation}': must be one of {', '.join(SATURATIONS)}")
        if self.projection is not None and (self.projection.ndim != 2 or self.projection.shape[0] != n):
            raise KoopmanError(f"the projection has shape {self.projection.shape}, must have {n} rows")

    @property
    def _u_ref(self) -> Array:
        assert self.u_ref is not None
        return self.u_ref

    def latent(self, x: ArrayLike) -> Array:
        """Return z (n,) or (N, n) for one observation or many."""
        z = self.encoder(x)
        return z if self.projection is None else z @ self.projection.T

    def control(self, z: Array) -> Array:
        """Return u (m,) or (N, m): what the linear law asks for."""
        return self.k - z @ self.K.T

    def saturate(self, u: Array) -> Array:
        """Return the action in [-1, 1] that stands for u."""
        return np.tanh(u) if self.saturation == "tanh" else np.clip(u, -1.0, 1.0)

    def action(self, x: ArrayLike) -> Array:
        """Return the action (m,) in [-1, 1] for one observation."""
        return self.saturate(self.control(self.latent(x)))

    def predict(self, z: Array, action: Array) -> Array:
        """Return the model's next z under an action in [-1, 1]."""
        if self.horizon is None:
            return self.z_ref + self.model.predict(z - self.z_ref, action - self.saturate(self._u_ref))
        return self.model.predict(z, action)

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""
        deviation = z - self.z_ref
        return float(deviation @ self.P @ deviation)
