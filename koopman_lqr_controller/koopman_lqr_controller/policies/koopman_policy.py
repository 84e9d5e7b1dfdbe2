"""Parts common to all policies: observation, decision, and the closed-loop model for analysis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.models.edmd import LinearModel


class ObservationFn(Protocol):
    """Function from a scan and odometry to an observation."""

    def __call__(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float, /) -> Array:
        """Return the observation x (n,).

        Args:
            ranges: Distances of the scan's beams (beams,) [m].
            scan: Geometry of the scan.
            v: Odometry speed [m/s].
            omega: Odometry turn rate [rad/s].

        Raises:
            KoopmanError: The scan has no measurement, or speed or turn rate are not finite.
        """


class Decision(NamedTuple):
    """Command for one scan, with intermediate results.

    Attributes:
        command: Control clamped to the limits (2,): speed [m/s], turn rate [rad/s].
        control: Control before clamping (2,).
        z: Lifted state (n,).
    """

    command: Array
    control: Array
    z: Array


LEARNT, CONSOLIDATED, TWO_STAGES = "as learnt", "consolidated", "two stages"


@dataclass(frozen=True)
class ClosedLoopModel:
    """Linear model and law of a policy. The control u is the model's own: actions in [-1, 1], or commands.

    Attributes:
        kind: `LEARNT`, the gain of a few Riccati iterations; `CONSOLIDATED`, the LQR of its own model; `TWO_STAGES`,
            EDMD with fixed observables.
        model: Linear model with A (n, n) and B (n, m).
        K: Gain (m, n).
        P: Cost-to-go (n, n).
        Q: Diagonal of the state cost (n,).
        R: Diagonal of the control cost (m,).
        z_ref: Reference of z (n,).
        slope: Derivative of the control with respect to the law's u at the reference (m,): 1, or that of tanh.
        latent: Function from observations (*shape) or (N, *shape) to z; the identity if x is z.
        control: Function from z to the control within its limits.
        predict: Function from z (N, n) and controls (N, m) to the model's next z (N, n).
        low: Minimum control (m,).
        high: Maximum control (m,).
    """

    kind: str
    model: LinearModel
    K: Array
    P: Array
    Q: Array
    R: Array
    z_ref: Array
    slope: Array
    latent: Callable[[Array], Array]
    control: Callable[[Array], Array]
    predict: Callable[[Array, Array], Array]
    low: Array
    high: Array

    @property
    def closed(self) -> Array:
        """A - B diag(slope) K (n, n), the actual loop near the reference."""
        return self.model.A - self.model.B @ (self.slope[:, None] * self.K)

    @property
    def gain(self) -> Array:
        """K (m, n) in terms of actions in [-1, 1], so that its rows have comparable units."""
        return 2.0 * self.K / (self.high - self.low)[:, None]

    def action(self, u: Array) -> Array:
        """Convert a control within its limits to an action in [-1, 1]."""
        return 2.0 * (u - self.low) / (self.high - self.low) - 1.0

    def cost_to_go(self, z: Array) -> Array:
        """Return (z - z_ref)^T P (z - z_ref) (N,) of z (N, n)."""
        deviation = z - self.z_ref
        return np.asarray(np.sum((deviation @ self.P) * deviation, axis=1), dtype=np.float64)
