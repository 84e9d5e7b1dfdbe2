"""The interface that both kinds of policies implement: from a scan to a command, and the linear model behind it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.policies.closed_loop_model import ClosedLoopModel
from koopman_lqr_controller.safety.latent_distribution import LatentDistribution
from koopman_lqr_controller.sensing.lidar import ScanGeometry, Sectors

Array = NDArray[np.float64]


class ObservationFn(Protocol):
    """Function from a scan and odometry to an observation."""

    def __call__(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float, /) -> Array:
        """Return the observation x (n,).

        Args:
            ranges: Distances of the scan's beams (beams,) [m].
            scan: Geometry of the scan.
            v: Speed by odometry [m/s].
            omega: Turn rate by odometry [rad/s].

        Raises:
            KoopmanError: the scan holds no measurement, or speed or turn rate are not finite.
        """


class Decision(NamedTuple):
    """Command for one scan, and how it came about.

    Attributes:
        command: Control clamped to the limits (2,): speed [m/s], turn rate [rad/s].
        control: Control before clamping (2,).
        z: Lifted state (n,).
    """

    command: Array
    control: Array
    z: Array


class KoopmanPolicy(Protocol):
    """A linear quadratic regulator on lifted observations of a lidar, however it was learnt."""

    @property
    def manifest(self) -> Mapping[str, Any]:
        """Origin and figures of the policy: plain JSON values."""

    @property
    def dt(self) -> float | None:
        """Time step of the model [s]; None where the file does not say."""

    @property
    def z_ref(self) -> Array:
        """Reference of the lifted state (n,)."""

    @property
    def sectors(self) -> Sectors:
        """Sectors that a scan is resampled to."""

    @property
    def limits(self) -> tuple[Array, Array]:
        """Least and largest command (2,), (2,): speed [m/s], turn rate [rad/s]."""

    @property
    def distribution(self) -> LatentDistribution | None:
        """Distribution of the lifted states in training; None where the file does not say."""

    @property
    def loop(self) -> Array:
        """A - B K (n, n)."""

    def decide(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Decision:
        """Return the command for one scan and the odometry's speed [m/s] and turn rate [rad/s]."""

    def predict(self, z: Array, command: Array) -> Array:
        """Return the model's next z (n,) under a command (2,), which counts as the nearest within the limits."""

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""

    def closed_loop_model(self) -> ClosedLoopModel:
        """Return the policy as control theory sees it."""

    @property
    def observation_fn(self) -> ObservationFn:
        """Function from a scan and odometry to x.

        Raises:
            KoopmanError: the policy is of a task without a lidar.
        """

    def to_controls(self, commands: Array) -> Array:
        """Return the model's controls (N, m) of recorded commands (N, 2).

        Raises:
            KoopmanError: the policy is of a task without a lidar.
        """

    def to_commands(self, controls: Array) -> Array:
        """Return the commands (N, 2) of the model's controls (N, m).

        Raises:
            KoopmanError: the policy is of a task without a lidar.
        """
