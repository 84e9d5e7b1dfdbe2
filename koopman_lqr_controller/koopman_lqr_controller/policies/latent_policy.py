"""A task-oriented Koopman policy (thesis chapter 4): the latent controller, and its interface to a lidar robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry, Sectors
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import FusedEncoder, LatentController
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.policies.koopman_policy import (
    CONSOLIDATED,
    LEARNT,
    ClosedLoopModel,
    Decision,
    ObservationFn,
)
from koopman_lqr_controller.safety.guards import LatentDistribution, check_distribution
from koopman_lqr_controller.sensing.lidar_observation import LidarObservation


@dataclass(frozen=True)
class RobotInterface:
    """Connection between a lidar robot and a latent controller.

    Attributes:
        observation: Observation x of a scan and odometry.
        u_low: Command of action -1 (2,): speed [m/s], turn rate [rad/s].
        u_high: Command of action 1 (2,): speed [m/s], turn rate [rad/s].
    """

    observation: LidarObservation
    u_low: Array
    u_high: Array

    def __post_init__(self) -> None:
        if not (np.isfinite(self.u_low).all() and np.isfinite(self.u_high).all()):
            raise KoopmanError("u_low and u_high hold values that are not finite")
        if self.u_low.shape != (2,) or self.u_high.shape != (2,) or not (self.u_low < self.u_high).all():
            raise KoopmanError("u_low and u_high must be two numbers each, u_low below u_high")

    def command(self, action: Array) -> Array:
        """Convert an action (2,) to a command (2,)."""
        return self.u_low + (action + 1.0) * self.half

    @cached_property
    def half(self) -> Array:
        """Half the range of the commands (2,), which scales actions in [-1, 1]."""
        return 0.5 * (self.u_high - self.u_low)

    def action(self, command: Array) -> Array:
        """Return the actions (2,) or (N, 2) in [-1, 1] whose commands are nearest to the given ones."""
        return np.clip(2.0 * (command - self.u_low) / (self.u_high - self.u_low) - 1.0, -1.0, 1.0)


@dataclass(frozen=True)
class LatentPolicy:
    """A controller with its conditions of use. Robot-related members raise KoopmanError if the task has no lidar.

    Attributes:
        controller: The latent controller.
        dt: Decision period, and time step of the model [s].
        robot_interface: Connection to a robot with a lidar; None for tasks without one, e.g. those of the DeepMind
            control suite.
        manifest: Provenance, method and metrics of the policy: plain JSON values.
        distribution: Distribution of the latents in training; None if the file has none.
    """

    controller: LatentController
    dt: float
    robot_interface: RobotInterface | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)
    distribution: LatentDistribution | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.dt < float("inf"):
            raise KoopmanError(f"dt is {self.dt} s: must be positive")
        check_distribution(self.distribution, len(self.z_ref))
        if self.robot_interface is not None:
            wanted, controls = (len(self.robot_interface.observation.names),), len(self.controller.R)
            if self.controller.encoder.shape != wanted or controls != 2:
                raise KoopmanError(
                    f"the encoder takes {self.controller.encoder.shape} and {controls} controls come out, "
                    f"the robot gives {wanted} and takes 2"
                )

    @property
    def z_ref(self) -> Array:
        """Goal in the latent space (n,)."""
        return self.controller.z_ref

    @property
    def required_interface(self) -> RobotInterface:
        """The interface to the robot.

        Raises:
            KoopmanError: The policy's task has no lidar.
        """
        if self.robot_interface is None:
            raise KoopmanError(f"this policy is for the task {self.manifest.get('task')}, which has no lidar")
        return self.robot_interface

    @property
    def sectors(self) -> Sectors:
        """Sectors to which a scan is resampled."""
        return self.required_interface.observation.sectors

    @property
    def limits(self) -> tuple[Array, Array]:
        """Minimum and maximum command (2,), (2,): speed [m/s], turn rate [rad/s]."""
        return self.required_interface.u_low, self.required_interface.u_high

    @cached_property
    def _latent(self) -> Callable[[Array], Array]:
        """Function from an observation to z: the fused encoder, or the controller's own if it cannot be fused."""
        try:
            return FusedEncoder(self.controller.encoder, self.controller.projection)
        except KoopmanError:
            return self.controller.latent

    @cached_property
    def _gain(self) -> Array:
        """Gain K in command units (2, n)."""
        return self.required_interface.half[:, None] * self.controller.K

    @cached_property
    def _offset(self) -> Array:
        """Offset k in command units (2,)."""
        return self.required_interface.command(self.controller.k)

    @property
    def loop(self) -> Array:
        """Closed-loop matrix A - B K (n, n)."""
        return self.controller.model.A - self.controller.model.B @ self.controller.K

    def decide(self, ranges: NDArray[np.float32], scan: ScanGeometry, v: float, omega: float) -> Decision:
        """Return the command for one scan and the odometry's speed [m/s] and turn rate [rad/s].

        Raises:
            KoopmanError: The scan has no measurement, or speed or turn rate are not finite.
        """
        robot_interface, controller = self.required_interface, self.controller
        z = self._latent(robot_interface.observation.observe(ranges, scan, v, omega))
        if controller.horizon is not None:
            u = controller.control(z)
            return Decision(robot_interface.command(controller.saturate(u)), robot_interface.command(u), z)
        # Actions are clipped where commands are, so working with commands is fastest.
        control = self._offset - self._gain.dot(z)
        return Decision(np.minimum(np.maximum(control, robot_interface.u_low), robot_interface.u_high), control, z)

    def predict(self, z: Array, command: Array) -> Array:
        """Return the model's next z (n,) under a command (2,), clipped to the limits."""
        return self.controller.predict(z, self.required_interface.action(command))

    def cost_to_go(self, z: Array) -> float:
        """Return (z - z_ref)^T P (z - z_ref)."""
        return self.controller.cost_to_go(z)

    def closed_loop_model(self) -> ClosedLoopModel:
        """Return the closed-loop model; its controls are actions in [-1, 1]."""
        controller = self.controller
        controls, learnt = len(controller.R), controller.horizon is not None
        slope = 1.0 - np.tanh(controller.control(controller.z_ref)) ** 2 if learnt else np.ones(controls)
        return ClosedLoopModel(
            kind=LEARNT if learnt else CONSOLIDATED,
            model=controller.model,
            K=controller.K,
            P=controller.P,
            Q=controller.Q,
            R=controller.R,
            z_ref=controller.z_ref,
            slope=slope,
            latent=controller.latent,
            control=lambda z: controller.saturate(controller.control(z)),
            predict=controller.predict,
            low=-np.ones(controls),
            high=np.ones(controls),
        )

    @property
    def observation_fn(self) -> ObservationFn:
        """Function from a scan and odometry to x."""
        return self.required_interface.observation.observe

    def to_controls(self, commands: Array) -> Array:
        """Return the actions (N, 2) in [-1, 1] whose commands are nearest to the given ones (N, 2)."""
        return self.required_interface.action(commands)

    def to_commands(self, controls: Array) -> Array:
        """Convert actions (N, 2) to commands (N, 2)."""
        return self.required_interface.command(controls)
