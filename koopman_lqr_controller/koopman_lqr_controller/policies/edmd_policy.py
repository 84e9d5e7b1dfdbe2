"""A Koopman-LQR controller as it runs on the robot: lift, multiply, clamp. NumPy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.safety.latent_distribution import LatentDistribution, check_distribution
from koopman_lqr_controller.sensing.lidar import ScanGeometry, Sectors
from koopman_lqr_controller.sensing.observables import CorridorObservables

Array = NDArray[np.float64]


class Decision(NamedTuple):
    """One command and how it came about.

    Attributes:
        command: u clamped to the limits (2,): speed [m/s], turn rate [rad/s].
        control: u before clamping (2,).
        z: lifted state (n,).
    """

    command: Array
    control: Array
    z: Array


class KoopmanPolicy(Protocol):
    """What a node needs of a policy, however it was learnt."""

    @property
    def manifest(self) -> Mapping[str, Any]:
        """What was learned from, and how well: plain JSON values."""

    @property
    def dt(self) -> float | None:
        """Time for which the model predicts [s]; None where the file does not say."""

    @property
    def z_ref(self) -> Array:
        """Where to be (n,)."""

    @property
    def sectors(self) -> Sectors:
        """What the policy takes from a scan."""

    @property
    def limits(self) -> tuple[Array, Array]:
        """Least and largest command (2,), (2,): speed [m/s], turn rate [rad/s]."""

    @property
    def distribution(self) -> LatentDistribution | None:
        """What training saw; None where the file does not say."""

    @property
    def loop(self) -> Array:
        """A - B K (n, n)."""

    def decide(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Decision:
        """Return the command for one scan and the odometry's speed [m/s] and turn rate [rad/s]."""

    def predict(self, z: Array, command: Array) -> Array:
        """Return the model's next z (n,) under a command (2,), which counts as the nearest within the limits."""

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""


@dataclass(frozen=True)
class EdmdPolicy:
    """u = u_ref - K (z - z_ref), z = Psi(x).

    Attributes:
        observables: Psi.
        model: of deviations from the reference.
        K: gain (2, n).
        P: cost-to-go (n, n).
        z_ref: where to be (n,).
        u_ref: what holds it there (2,): speed [m/s], turn rate [rad/s].
        u_low: least command (2,).
        u_high: largest command (2,).
        manifest: what was learned from, and how well: plain JSON values.
        distribution: what training saw; None where it was not written down.
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
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise KoopmanError(f"{name} has shape {array.shape}, must have {shape} for {n} observables")
            if not np.isfinite(array).all():
                raise KoopmanError(f"{name} holds values that are not finite")
        if not (self.u_low < self.u_high).all():
            raise KoopmanError("u_low must lie below u_high")
        dt = self.manifest.get("dt")
        if dt is not None and not (isinstance(dt, int | float) and 0.0 < dt < float("inf")):
            raise KoopmanError(f"dt is {dt}: must be a positive time")
        check_distribution(self.distribution, n)

    @property
    def dt(self) -> float | None:
        """Time for which the model predicts [s]; None where the manifest does not say."""
        dt = self.manifest.get("dt")
        return None if dt is None else float(dt)

    @property
    def sectors(self) -> Sectors:
        """What the policy takes from a scan."""
        return self.observables.sectors

    @property
    def limits(self) -> tuple[Array, Array]:
        """Least and largest command (2,), (2,): speed [m/s], turn rate [rad/s]."""
        return self.u_low, self.u_high

    @property
    def loop(self) -> Array:
        """A - B K (n, n)."""
        return self.model.A - self.model.B @ self.K

    def decide(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Decision:
        """Return the command for one scan and the odometry's speed [m/s] and turn rate [rad/s].

        Raises:
            KoopmanError: nothing can be seen in the scan, or speed or turn rate are not finite.
        """
        z = self.observables.observe(ranges, scan, v, omega)
        control = self.u_ref - self.K.dot(z - self.z_ref)
        return Decision(np.minimum(np.maximum(control, self.u_low), self.u_high), control, z)

    def predict(self, z: Array, command: Array) -> Array:
        """Return the model's next z (n,) under a command (2,), which counts as the nearest within the limits."""
        command = np.clip(command, self.u_low, self.u_high)
        return self.z_ref + self.model.predict(z - self.z_ref, command - self.u_ref)

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""
        deviation = z - self.z_ref
        return float(deviation @ self.P @ deviation)
