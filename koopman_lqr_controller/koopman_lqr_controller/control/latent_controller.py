"""Linear control in a learnt latent space (thesis Eq. 4.8, 4.9), as run on the robot. NumPy only.

The gain is not stored but computed from A, B, Q, R when a policy is created, so it always matches its model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from koopman_lqr_controller.arrays import Array, check_arrays
from koopman_lqr_controller.control.riccati import finite_horizon, solve_lqr
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.models.encoder import EPSILON, Dense, Encoder, LayerNorm, Rectifier, Weights

_ZERO = np.array(0.0, np.float32)  # NumPy takes twice as long with a Python number


@dataclass(frozen=True)
class LatentController:
    """u = k - K z with z = C psi(x); the action is u mapped to [-1, 1].

    With a `horizon`, the gain is that of Algorithm 1 after that many iterations, k tracks the reference, the action is
    tanh(u), and the model describes z; this is what learning optimises. Without a horizon, the law is the
    infinite-horizon regulator, and the model describes deviations from z_ref and a_ref, with a drift: u = a_ref - K (z
    - z_ref) is the action itself, clipped to [-1, 1]. Since a_ref is inside these limits, the deployed loop around
    z_ref is A - B K; this is what consolidation produces. The drift moves the loop's fixed point but not its poles.

    Attributes:
        encoder: Embedding psi of observations.
        model: Linear model with A (n, n) and B (n, m).
        Q: Diagonal of the state cost (n,).
        R: Diagonal of the control cost (m,).
        z_ref: Goal (n,); zeros without a goal.
        a_ref: Action at z_ref (m,), inside (-1, 1); zeros by default. Infinite horizon only.
        drift: Change of the model's z per step at the reference (n,); zeros by default. Infinite horizon only.
        horizon: Number of Riccati iterations; None for the infinite horizon.
        projection: Projection C (n, encoder's n) to a reduced latent space; None for the identity.
        K: Gain (m, n).
        k: Offset of the law (m,).
        P: Cost-to-go (n, n).
        spectral_radius: Spectral radius of A - B K.
        residual: Relative residual of the algebraic Riccati equation; infinite with a finite horizon.
    """

    encoder: Encoder
    model: LinearModel
    Q: Array
    R: Array
    z_ref: Array
    horizon: int | None = None
    projection: Array | None = None
    a_ref: Array = None  # type: ignore[assignment]  # zeros
    drift: Array = None  # type: ignore[assignment]
    K: Array = field(init=False)
    k: Array = field(init=False)
    P: Array = field(init=False)
    spectral_radius: float = field(init=False)
    residual: float = field(init=False)

    def __post_init__(self) -> None:
        for name, size in (("a_ref", len(self.R)), ("drift", len(self.Q))):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(size))
        self._check()
        self._try_out()
        if self.horizon is None:
            regulator = solve_lqr(self.model, np.diag(self.Q), np.diag(self.R))
            K, P, k = regulator.K, regulator.P, self.a_ref + regulator.K @ self.z_ref
            radius, residual = regulator.spectral_radius, regulator.residual
        else:
            K, k, P = finite_horizon(self.model, self.Q, self.R, self.z_ref, self.horizon)
            radius = float(np.abs(np.linalg.eigvals(self.model.A - self.model.B @ K)).max())
            residual = float("inf")
        if not (np.isfinite(K).all() and np.isfinite(k).all() and np.isfinite(P).all()):
            raise KoopmanError("the gain of this model is not finite")
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
            "a_ref": (self.a_ref, (m,)),
            "drift": (self.drift, (n,)),
        }
        check_arrays(shapes, "for the B it comes with")
        if (self.Q < 0.0).any() or (self.R <= 0.0).any():
            raise KoopmanError("Q must not be negative, and R must be positive")
        if self.horizon is not None and (self.horizon < 1 or self.a_ref.any() or self.drift.any()):
            raise KoopmanError(
                f"horizon is {self.horizon}: must be at least 1 and without a_ref and drift, or null for infinity"
            )
        if (np.abs(self.a_ref) >= 1.0).any():
            raise KoopmanError(f"a_ref is {self.a_ref}: must lie inside -1 .. 1, else the loop is not linear there")
        if self.projection is not None and not np.isfinite(self.projection).all():
            raise KoopmanError("the projection holds values that are not finite")
        if self.projection is not None and (self.projection.ndim != 2 or self.projection.shape[0] != n):
            raise KoopmanError(f"the projection has shape {self.projection.shape}, must have {n} rows")

    def _try_out(self) -> None:
        """Encode one observation, so that an encoder that fails is detected before driving."""
        try:
            z = self.latent(np.zeros(self.encoder.shape, np.float32))
        except (ValueError, IndexError) as error:
            raise KoopmanError(f"encoder and projection do not fit each other ({error})") from None
        if z.shape != self.z_ref.shape or not np.isfinite(z).all():
            raise KoopmanError(
                f"an observation of zeros becomes {z.shape}, must become {len(self.z_ref)} finite numbers"
            )

    def latent(self, x: ArrayLike) -> Array:
        """Return z (n,) or (N, n) for one observation or many."""
        return self.project(self.encoder(x))

    def project(self, psi: Array) -> Array:
        """Return z = C psi (n,) or (N, n)."""
        return psi if self.projection is None else psi.dot(self.projection.T)

    def control(self, z: Array) -> Array:
        """Return the output u (m,) or (N, m) of the linear law."""
        return self.k - z.dot(self.K.T)

    def saturate(self, u: Array) -> Array:
        """Map u to the action in [-1, 1]."""
        return np.minimum(np.maximum(u, -1.0), 1.0) if self.horizon is None else np.tanh(u)

    def action(self, x: ArrayLike) -> Array:
        """Return the action (m,) in [-1, 1] for one observation."""
        return self.saturate(self.control(self.latent(x)))

    def predict(self, z: Array, action: Array) -> Array:
        """Return the model's next z under an action in [-1, 1]."""
        if self.horizon is None:
            return self.z_ref + self.drift + self.model.predict(z - self.z_ref, action - self.a_ref)
        return self.model.predict(z, action)

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""
        deviation = z - self.z_ref
        return float(deviation @ self.P @ deviation)


class _Step(NamedTuple):
    """A matrix (in + 1, out + 1) for homogeneous vectors (last entry 1), followed by a nonlinearity."""

    matrix: Weights
    rectified: bool = False
    normalised: bool = False


class FusedEncoder:
    """C psi(x) for one x, with all linear operations between two nonlinearities fused to one matrix.

    The result differs from the encoder's only by rounding.

    Args:
        encoder: Encoder psi, with dense layers and norms only.
        projection: C (n, encoder's n); None for the identity.

    Raises:
        KoopmanError: The encoder contains other layers.
    """

    def __init__(self, encoder: Encoder, projection: Array | None = None) -> None:
        if len(encoder.shape) != 1 or encoder.inclusive:
            raise KoopmanError("only an encoder of vectors that gives its last layer's outputs can be fused")
        self._size = encoder.shape[0]
        unit = np.broadcast_to(np.asarray(encoder.unit, float), self._size)
        linear = _affine(np.diag(1.0 / unit), -encoder.middle / unit)
        self._steps: list[_Step] = []
        for layer in encoder.layers:
            if isinstance(layer, Dense):
                linear = _affine(layer.weight, layer.bias) @ linear
            elif isinstance(layer, LayerNorm):
                n = len(layer.weight)
                self._steps.append(_Step(_float32(_affine(np.eye(n) - 1.0 / n, np.zeros(n)) @ linear), normalised=True))
                linear = _affine(np.diag(layer.weight), layer.bias)
            elif not isinstance(layer, Rectifier):
                raise KoopmanError(
                    f"only an encoder of dense layers and norms can be fused, not one with {type(layer).__name__}"
                )
            if isinstance(layer, Rectifier) or (isinstance(layer, Dense) and layer.rectified):
                self._steps.append(_Step(_float32(linear), rectified=True))
                linear = np.eye(len(linear))
        if projection is not None:
            linear = _affine(projection, np.zeros(len(projection))) @ linear
        self._last = _float32(linear[:-1])

    def __call__(self, x: ArrayLike) -> Array:
        """Return z (n,) for one observation (its size,)."""
        y = np.empty(self._size + 1, np.float32)
        y[:-1], y[-1] = x, 1.0
        for matrix, rectified, normalised in self._steps:
            y = y.dot(matrix)
            if rectified:
                np.maximum(y, _ZERO, out=y)
            if normalised:
                values = y[:-1]
                values *= 1.0 / math.sqrt(values.dot(values) / len(values) + EPSILON)
        return y.dot(self._last).astype(np.float64)


def _affine(weight: ArrayLike, bias: ArrayLike) -> Array:
    """Return the matrix (out + 1, in + 1) of W x + b."""
    W, b = np.asarray(weight, float), np.asarray(bias, float)
    out = np.zeros((W.shape[0] + 1, W.shape[1] + 1))
    out[:-1, :-1], out[:-1, -1], out[-1, -1] = W, b, 1.0
    return out


def _float32(matrix: Array) -> Weights:
    """Return the transpose in row-major order, which makes vector products fastest."""
    return np.ascontiguousarray(matrix.T, np.float32)
