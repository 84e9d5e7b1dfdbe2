"""Learns a latent policy from recorded drives: Algorithm 2 with the driver's commands in place of a reward.

Encoder, model, differentiable LQR, contrastive loss (Eq. 4.4) and model loss (Eq. 4.7) are the same as in online
learning. Since a recording does not contain exploration and critics are unreliable for actions not in the data, the
LQR's action is fitted to the recorded one instead. Mirrored drives are equally valid and double the data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch
from ctrl_rl_learning.torch import gradient_step
from torch import Tensor

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.trajectory_segments import TrajectorySegment, mean_time_step
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.policies.latent_policy import LatentPolicy, RobotInterface
from koopman_lqr_controller.sensing.lidar_observation import LidarObservation
from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr
from koopman_lqr_controller.training.networks.encoder_losses import info_nce, noisy
from koopman_lqr_controller.training.networks.networks import TorchEncoder, follow


@dataclass(frozen=True)
class ImitationSettings:
    """Settings of imitation.

    Attributes:
        latent: Dimension of z.
        hidden: Number of units of each of the two hidden layers.
        riccati_iterations: Number M of iterations of Algorithm 1.
        updates: Number of updates.
        batch: Number of steps per batch.
        learning_rate: Learning rate of all parameters.
        noise: Noise eta of Eq. 4.5, used in all losses because recordings are short and noisy.
        model_weight: Weight of the model loss, which also trains the encoder; a large weight would collapse the
            latents.
        key_rate: Update rate of the key encoder.
        seed: Random seed of weights and batches.
    """

    latent: int = 16
    hidden: int = 64
    riccati_iterations: int = 5
    updates: int = 1500
    batch: int = 128
    learning_rate: float = 1e-3
    noise: float = 0.3
    model_weight: float = 0.1
    key_rate: float = 0.05
    seed: int = 0


def imitate(
    segments: Sequence[TrajectorySegment],
    observation: LidarObservation,
    settings: ImitationSettings | None = None,
    on_progress: Callable[[], object] = lambda: None,
) -> LatentPolicy:
    """Return the learnt policy, with the gain of a few Riccati iterations; `offline.refit` consolidates it.

    Its commands span the range of recorded commands, symmetrically to both sides.

    Args:
        segments: Segments with x from `observation`, and commands.
        observation: Observation of a scan and odometry.
        settings: Training settings; the default ones if omitted.
        on_progress: Called after each update.

    Raises:
        KoopmanError: There are fewer steps than in a batch, or a command never changes.
    """
    settings = settings or ImitationSettings()
    steps = sum(len(segment) for segment in segments)
    if steps < settings.batch:
        raise KoopmanError(f"{steps} steps are too few to learn from: {settings.batch} at least")
    robot_interface = _robot_interface(segments, observation)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        imitation = _Imitation(_Data.of(segments, robot_interface), settings)
        for _ in range(settings.updates):
            imitation.update()
            on_progress()
    return LatentPolicy(imitation.deploy(), mean_time_step(segments), robot_interface)


def _robot_interface(segments: Sequence[TrajectorySegment], observation: LidarObservation) -> RobotInterface:
    u = np.concatenate([segment.u for segment in segments])
    turn = float(np.abs(u[:, 1]).max())
    low, high = np.array([min(0.0, u[:, 0].min()), -turn]), np.array([u[:, 0].max(), turn])
    if not (low < high).all():
        raise KoopmanError(
            f"speed is commanded up to {high[0]:g} m/s, turn rate to {turn:g} rad/s: nothing to learn from"
        )
    return RobotInterface(observation, low, high)


@dataclass(frozen=True)
class _Data:
    """Steps and their mirror images, as tensors."""

    x: Tensor
    u: Tensor
    x_next: Tensor

    @classmethod
    def of(cls, segments: Sequence[TrajectorySegment], robot_interface: RobotInterface) -> _Data:
        order, sign = robot_interface.observation.mirror

        def both(rows: Array) -> Tensor:
            return torch.from_numpy(np.concatenate((rows, rows[:, order] * sign)).astype(np.float32))

        u = robot_interface.action(np.concatenate([segment.u for segment in segments]))
        return cls(
            both(np.concatenate([segment.x[:-1] for segment in segments])),
            torch.from_numpy(np.concatenate((u, u * (1.0, -1.0))).astype(np.float32)),
            both(np.concatenate([segment.x[1:] for segment in segments])),
        )


class _Imitation:
    """State of the imitation between updates."""

    def __init__(self, data: _Data, settings: ImitationSettings) -> None:
        self._data, self._settings = data, settings
        size = data.x.shape[1]
        middle, unit = data.x.mean(dim=0), data.x.std(dim=0) + 1e-3
        self._encoder, self._keys = (
            TorchEncoder((size,), settings.latent, settings.hidden, 2, middle, unit) for _ in range(2)
        )
        self._keys.load_state_dict(self._encoder.state_dict())
        self._keys.requires_grad_(False)
        self._lqr = LatentLqr(settings.latent, data.u.shape[1], settings.riccati_iterations)
        self._W = torch.nn.Parameter(torch.eye(settings.latent))
        self._goal = torch.zeros(settings.latent)
        parameters = chain(self._encoder.parameters(), self._lqr.parameters(), [self._W])
        self._optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate)
        self._generator = torch.Generator().manual_seed(settings.seed)

    def update(self) -> None:
        """Train on one batch."""
        settings, data, generator = self._settings, self._data, self._generator
        rows = torch.randint(len(data.x), (settings.batch,), generator=generator)
        x, u = data.x[rows], data.u[rows]
        z, z_next = (self._encoder(noisy(each, settings.noise, generator)) for each in (x, data.x_next[rows]))
        keys = self._keys(noisy(x, settings.noise, generator))
        K, k = self._lqr.gain(self._goal)
        loss = info_nce(z, keys, self._W)
        loss = loss + (torch.tanh(k - z @ K.T) - u).square().sum(dim=1).mean()
        loss = loss + settings.model_weight * self._lqr.model_loss(z, u, z_next)
        gradient_step(self._optimizer, loss)
        follow(self._keys, self._encoder, settings.key_rate)

    def deploy(self) -> LatentController:
        """Return the learnt policy without torch."""
        lqr = self._lqr
        A, B, Q, R = (
            each.detach().numpy().astype(np.float64) for each in (lqr.A, lqr.B, lqr.log_Q.exp(), lqr.log_R.exp())
        )
        goal = np.zeros(len(Q))
        return LatentController(self._encoder.deploy(), LinearModel(A, B), Q, R, goal, lqr.iterations)
