"""The two-stage policy (thesis 2.3.1) as run on the robot: lift, multiply, clamp. NumPy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry, Sectors
from koopman_lqr_controller.arrays import Array, check_arrays
from koopman_lqr_controller.control.linear_analysis import costs_of
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.policies.koopman_policy import TWO_STAGES, ClosedLoopModel, Decision, ObservationFn
from koopman_lqr_controller.safety.guards import LatentDistribution, check_distribution
from koopman_lqr_controller.sensing.observables import CorridorObservables


@dataclass(frozen=True)
class EdmdPolicy:
    """u = u_ref - K (z - z_ref), z = Psi(x).

    Attributes:
        observables: Observables Psi of a scan and odometry.
        model: Model of deviations from the reference.
        K: Gain (2, n).
        P: Cost-to-go (n, n).
        z_ref: Reference of the lifted state (n,).
        u_ref: Command that holds the reference (2,): speed [m/s], turn rate [rad/s].
        u_low: Minimum command (2,).
        u_high: Maximum command (2,).
        manifest: Provenance and metrics of the policy: plain JSON values.
        distribution: Distribution of the latents in training; None if the file has none.
    """

    observables: CorridorObservables
    model: LinearModel
    K: Array
    P: Array
    z_ref: Array
    u_ref: Array
    u_low: Array
    u_high: Array
    manifest: Mapping[str, Any] = field(default_factory=dict)
    distribution: LatentDistribution | None = None

    def __post_init__(self) -> None:
        n, m = len(self.observables.names), 2
        shapes = {
            "A": (self.model.A, (n, n)),
            "B": (self.model.B, (n, m)),
            "K": (self.K, (m, n)),
            "P": (self.P, (n, n)),
            "z_ref": (self.z_ref, (n,)),
            "u_ref": (self.u_ref, (m,)),
            "u_low": (self.u_low, (m,)),
            "u_high": (self.u_high, (m,)),
        }
        check_arrays(shapes, f"for {n} observables")
        if not (self.u_low < self.u_high).all():
            raise KoopmanError("u_low must lie below u_high")
        dt = self.manifest.get("dt")
        if dt is not None and not (isinstance(dt, int | float) and 0.0 < dt < float("inf")):
            raise KoopmanError(f"dt is {dt}: must be a positive time")
        check_distribution(self.distribution, n)

    @property
    def dt(self) -> float | None:
        """Time step of the model [s]; None if not in the manifest."""
        dt = self.manifest.get("dt")
        return None if dt is None else float(dt)

    @property
    def sectors(self) -> Sectors:
        """Sectors to which a scan is resampled."""
        return self.observables.sectors

    @property
    def limits(self) -> tuple[Array, Array]:
        """Minimum and maximum command (2,), (2,): speed [m/s], turn rate [rad/s]."""
        return self.u_low, self.u_high

    @property
    def loop(self) -> Array:
        """Closed-loop matrix A - B K (n, n)."""
        return self.model.A - self.model.B @ self.K

    def decide(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Decision:
        """Return the command for one scan and the odometry's speed [m/s] and turn rate [rad/s].

        Raises:
            KoopmanError: The scan has no measurement, or speed or turn rate are not finite.
        """
        z = self.observables.observe(ranges, scan, v, omega)
        control = self.u_ref - self.K.dot(z - self.z_ref)
        return Decision(np.minimum(np.maximum(control, self.u_low), self.u_high), control, z)

    def predict(self, z: Array, command: Array) -> Array:
        """Return the model's next z (n,) under a command (2,), clipped to the limits."""
        command = np.clip(command, self.u_low, self.u_high)
        return self.z_ref + self.model.predict(z - self.z_ref, command - self.u_ref)

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""
        deviation = z - self.z_ref
        return float(deviation @ self.P @ deviation)

    def closed_loop_model(self) -> ClosedLoopModel:
        """Return the closed-loop model; its controls are commands, and z is x."""
        z_ref, u_ref = self.z_ref, self.u_ref
        Q, R = costs_of(self.model, self.K, self.P)
        return ClosedLoopModel(
            kind=TWO_STAGES,
            model=self.model,
            K=self.K,
            P=self.P,
            Q=np.maximum(np.diag(Q), 0.0),  # an entry of 0 is recovered with rounding
            R=np.diag(R).copy(),
            z_ref=z_ref,
            slope=np.ones(len(u_ref)),
            latent=lambda x: np.asarray(x, dtype=np.float64),
            control=lambda z: np.clip(u_ref - (z - z_ref) @ self.K.T, self.u_low, self.u_high),
            predict=lambda z, u: z_ref + self.model.predict(z - z_ref, u - u_ref),
            low=self.u_low,
            high=self.u_high,
        )

    @property
    def observation_fn(self) -> ObservationFn:
        """The function from a scan and odometry to Psi."""
        return self.observables.observe

    def to_controls(self, commands: Array) -> Array:
        """Return the commands (N, 2) unchanged, since they are the model's controls."""
        return commands

    def to_commands(self, controls: Array) -> Array:
        """Return the controls (N, 2) unchanged, since they are commands."""
        return controls
