"""One view of both kinds of policies, for what is said of them: model, law, costs, and how to get from x to z."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.control.linear_analysis import costs_of
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.sensing.lidar import ScanGeometry

Array = NDArray[np.float64]
ObservationFn = Callable[[NDArray[np.float32], ScanGeometry, float, float], Array]
"""Ranges, their geometry, speed [m/s] and turn rate [rad/s] to an observation x; KoopmanError where it cannot be."""

LEARNT, CONSOLIDATED, TWO_STAGES = "as learnt", "consolidated", "two stages"


@dataclass(frozen=True)
class ClosedLoopModel:
    """A policy as control theory sees it. The control u is the model's own: actions in [-1, 1], or commands.

    Attributes:
        kind: `LEARNT`, the gain of a few Riccati iterations; `CONSOLIDATED`, the LQR of its own model; `TWO_STAGES`,
            EDMD with fixed observables.
        model: A (n, n), B (n, m).
        K: gain (m, n).
        P: cost-to-go (n, n).
        Q: diagonal of the state cost (n,).
        R: diagonal of the control cost (m,).
        z_ref: where to be (n,).
        slope: what becomes of a small change of the law's u there (m,): 1, or tanh's slope.
        latent: from observations (*shape) or (N, *shape) to z; the identity where x is z.
        control: the control that is done at z, within its limits.
        predict: the model's next z (N, n) of z (N, n) and controls (N, m).
        low: least control (m,).
        high: largest control (m,).
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
        """A - B diag(slope) K (n, n): the loop that runs, near the reference."""
        return self.model.A - self.model.B @ (self.slope[:, None] * self.K)

    @property
    def gain(self) -> Array:
        """K (m, n) in actions, which span -1 to 1: the units of its rows are alike."""
        return 2.0 * self.K / (self.high - self.low)[:, None]

    def action(self, u: Array) -> Array:
        """Return the action in [-1, 1] that stands for a control within its limits."""
        return 2.0 * (u - self.low) / (self.high - self.low) - 1.0

    def cost_to_go(self, z: Array) -> Array:
        """Return (z - z_ref)^T P (z - z_ref) (N,) of z (N, n)."""
        deviation = z - self.z_ref
        return np.asarray(np.sum((deviation @ self.P) * deviation, axis=1), dtype=np.float64)


def closed_loop_model(policy: EdmdPolicy | LatentPolicy) -> ClosedLoopModel:
    """Return a policy's loop."""
    if isinstance(policy, LatentPolicy):
        return _latent(policy.controller)
    z_ref, u_ref = policy.z_ref, policy.u_ref
    Q, R = costs_of(policy.model, policy.K, policy.P)
    return ClosedLoopModel(
        kind=TWO_STAGES,
        model=policy.model,
        K=policy.K,
        P=policy.P,
        Q=np.maximum(np.diag(Q), 0.0),  # what was 0 comes back as rounding
        R=np.diag(R).copy(),
        z_ref=z_ref,
        slope=np.ones(len(u_ref)),
        latent=lambda x: np.asarray(x, dtype=np.float64),
        control=lambda z: np.clip(u_ref - (z - z_ref) @ policy.K.T, policy.u_low, policy.u_high),
        predict=lambda z, u: z_ref + policy.model.predict(z - z_ref, u - u_ref),
        low=policy.u_low,
        high=policy.u_high,
    )


def _latent(controller: LatentController) -> ClosedLoopModel:
    controls = len(controller.R)
    learnt = controller.horizon is not None
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


def observation_fn(policy: EdmdPolicy | LatentPolicy) -> ObservationFn:
    """Return how a policy sees scan and odometry: its x.

    Raises:
        KoopmanError: the policy is of a task without a lidar.
    """
    return (
        policy.required_interface.observation.observe
        if isinstance(policy, LatentPolicy)
        else policy.observables.observe
    )


def controls_of(policy: EdmdPolicy | LatentPolicy, commands: Array) -> Array:
    """Return the model's controls (N, m) for recorded commands (N, 2): actions are cut off at -1 and 1.

    Raises:
        KoopmanError: the policy is of a task without a lidar.
    """
    return policy.required_interface.action(commands) if isinstance(policy, LatentPolicy) else commands


def commands_of(policy: EdmdPolicy | LatentPolicy, controls: Array) -> Array:
    """Return the commands (N, 2) of controls (N, m).

    Raises:
        KoopmanError: the policy is of a task without a lidar.
    """
    return policy.required_interface.command(controls) if isinstance(policy, LatentPolicy) else controls
