"""Finds coordinates in which a learnt policy is the LQR of a predictive model (beyond the thesis).

A learnt policy acts well, but its A and B serve the gain more than prediction, and no linear model of its latents
predicts much better. A small network phi therefore maps its features psi(x) to fewer, new coordinates z, and is trained
with A, B, a drift, Q and R on recorded steps only, so that

- the infinite-horizon LQR of A, B, Q, R acts like the learnt policy (inverse LQR, through the Riccati equation);
- the model predicts the next few z under the executed actions, and the law's next output.

Both prediction errors are relative to persistence, so shrinking the latents does not help; the second is independent of
the coordinates, so easily predicted components cannot mask those used by the law. Both are computed separately for
quiet and noisy episodes: otherwise the motion due to noise would hide errors where little moves, as on a driving robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from ctrl_rl_learning.torch import gradient_step
from torch import Tensor, nn

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import Episode
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.identification.regulators import reference_inside
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.models.encoder import Dense, Encoder
from koopman_lqr_controller.training.networks.differentiable_lqr import LatentLqr, doubled_gain
from koopman_lqr_controller.training.networks.networks import dense, deploy_layers

_BOUND = 1.1
"""Bound of the law's control, beyond which all actions are the same, up to a small leak with a gradient back."""
_LEAK = 0.01
_LEAST = 1e-6
"""Term added to mean squares in denominators."""
_LARGEST_GRADIENT = 1.0
"""Maximum gradient of the gain's parameters, which is unbounded near models that cannot be stabilised."""


@dataclass(frozen=True)
class DistillationSettings:
    """Settings of a candidate's training.

    Attributes:
        hidden: Number of units of phi's hidden layer.
        updates: Number of updates.
        batch: Number of episode sequences per batch.
        steps: Number of predicted steps per sequence.
        learning_rate: Maximum learning rate; it rises at first and then decays to 0.
        model_weight: Weight of the error of z.
        law_weight: Weight of the error of the law's output.
        groups: Number of equally weighted groups of episodes by noise level, with equally many steps each.
    """

    hidden: int = 256
    updates: int = 3000
    batch: int = 256
    steps: int = 3
    learning_rate: float = 3e-3
    model_weight: float = 0.3
    law_weight: float = 1.0
    groups: int = 3

    def with_prediction(self, share: float) -> DistillationSettings:
        """Return the settings with a lower weight on prediction."""
        return replace(self, model_weight=share * self.model_weight, law_weight=share * self.law_weight)


@dataclass(frozen=True)
class DistilledPolicy:
    """A regulator in its own coordinates, as a policy over the features of the learnt encoder.

    Attributes:
        encoder: Learnt encoder psi.
        coordinates: Coordinates phi of the features.
        controller: Infinite-horizon controller with phi after psi as its encoder.
    """

    encoder: Encoder
    coordinates: Encoder
    controller: LatentController

    def project(self, z: Array, /) -> Array:
        """Return phi of features."""
        return self.coordinates(z)

    def control(self, z: Array, /) -> Array:
        """Return u."""
        return self.controller.control(z)

    def saturate(self, u: Array, /) -> Array:
        """Map u to the action."""
        return self.controller.saturate(u)


def distil(
    learnt: LatentController,
    episodes: Sequence[Episode],
    latent: int,
    goal: bool,
    settings: DistillationSettings | None = None,
    seed: int = 0,
) -> DistilledPolicy:
    """Return the regulator equivalent to a learnt controller.

    Args:
        learnt: Learnt controller, with a finite horizon.
        episodes: Episodes of this or other policies with its features, labelled by its own actions.
        latent: Number of new coordinates.
        goal: Whether z_ref is a goal; otherwise the mean of the observed latents is used.
        settings: Training settings; the default ones if omitted.
        seed: Random seed of weights and batches.

    Raises:
        KoopmanError: No episode is as long as a sequence, or no regulator was found.
    """
    settings = settings or DistillationSettings()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        training = _Training(_Data.of(learnt, episodes, settings.steps, settings.groups), latent, settings)
        for _ in range(settings.updates):
            training.update()
    return training.deploy(learnt, episodes, goal)


@dataclass(frozen=True)
class _Data:
    """Episode sequences: features (N, steps + 1, n), executed (N, steps, m) and target actions (N, steps + 1, m).

    Attributes:
        psi: Features of the learnt encoder.
        done: Executed actions, without the last one.
        wanted: Target actions of the learnt policy.
        groups: One-hot noise group of each sequence (N, groups).
    """

    psi: Tensor
    done: Tensor
    wanted: Tensor
    groups: Tensor

    @classmethod
    def of(cls, learnt: LatentController, episodes: Sequence[Episode], steps: int, groups: int) -> _Data:
        stretches = [
            (episode.features[first : first + steps + 1], episode.actions[first : first + steps], episode.noise)
            for episode in episodes
            for first in range(len(episode.actions) - steps + 1)
        ]
        if not stretches:
            raise KoopmanError(f"no episode has {steps} steps: nothing to learn to predict from")
        psi, done, noise = (np.stack(part) for part in zip(*stretches, strict=True))
        wanted = learnt.saturate(learnt.control(psi))
        level = np.digitize(noise, np.quantile(noise, np.linspace(0.0, 1.0, groups + 1)[1:-1]))
        belongs = level[:, None] == np.unique(level)
        return cls(*(torch.from_numpy(part.astype(np.float32)) for part in (psi, done, wanted, belongs)))


class _Training:
    """State of the training between updates."""

    def __init__(self, data: _Data, latent: int, settings: DistillationSettings) -> None:
        self._data, self._settings = data, settings
        features, controls = data.psi.shape[-1], data.done.shape[-1]
        flat = data.psi.reshape(-1, features)
        self._middle, self._unit = flat.mean(dim=0), flat.std() + _LEAST
        self._scale = data.wanted.reshape(-1, controls).var(dim=0).sum() + _LEAST
        self._phi = nn.Sequential(*dense(features, settings.hidden, 1), nn.Linear(settings.hidden, latent))
        self._lqr = LatentLqr(latent, controls, 0)
        self._drift, self._offset = nn.Parameter(torch.zeros(latent)), nn.Parameter(torch.zeros(controls))
        self._linear = [*self._lqr.parameters(), self._drift, self._offset]
        parameters = [*self._phi.parameters(), *self._linear]
        self._optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate, fused=True)
        self._schedule = torch.optim.lr_scheduler.OneCycleLR(
            self._optimizer, settings.learning_rate, total_steps=settings.updates
        )

    def update(self) -> None:
        """Train on one batch."""
        data, settings = self._data, self._settings
        rows = torch.randint(len(data.psi), (settings.batch,))
        z = self._phi((data.psi[rows] - self._middle) / self._unit)
        K = self._gain()
        u = self._offset - z @ K.T
        bounded = u.clamp(-_BOUND, _BOUND)
        bounded = bounded + _LEAK * (u - bounded)
        loss = (bounded - data.wanted[rows]).square().sum(dim=-1).mean() / self._scale
        loss = loss + self._prediction_loss(z, u, K, data.done[rows], data.groups[rows])
        gradient_step(self._optimizer, loss, self._linear, largest_norm=_LARGEST_GRADIENT)
        self._schedule.step()

    def _prediction_loss(self, z: Tensor, u: Tensor, K: Tensor, done: Tensor, groups: Tensor) -> Tensor:
        """Return the weighted errors of z after each step and of u after one step, relative to persistence."""
        ahead, loss, steps = z[:, 0], torch.zeros(()), done.shape[1]
        for step in range(steps):
            ahead = self._lqr.predict(ahead, done[:, step]) + self._drift
            missed = _over(ahead - z[:, step + 1], z[:, step + 1] - z[:, 0], groups)
            loss = loss + self._settings.model_weight * missed / steps
            if step == 0:
                asked = self._offset - ahead @ K.T
                loss = loss + self._settings.law_weight * _over(asked - u[:, 1], u[:, 1] - u[:, 0], groups)
        return loss

    def _gain(self) -> Tensor:
        lqr = self._lqr
        return doubled_gain(lqr.A, lqr.B, lqr.log_Q.exp(), lqr.log_R.exp())

    def deploy(self, learnt: LatentController, episodes: Sequence[Episode], goal: bool) -> DistilledPolicy:
        """Return the result without torch.

        Raises:
            KoopmanError: The result is not finite, or has no regulator.
        """
        first, *others = deploy_layers(self._phi)
        assert isinstance(first, Dense)
        weight = first.weight / float(self._unit)
        first = Dense(weight, first.bias - weight @ self._middle.numpy(), first.rectified)
        size = weight.shape[1]
        phi = Encoder((first, *others), (size,), np.zeros(size, np.float32), np.ones(size, np.float32))

        lqr = self._lqr
        tensors = (lqr.A, lqr.B, lqr.log_Q.exp(), lqr.log_R.exp(), self._drift, self._offset, self._gain())
        A, B, Q, R, drift, offset, K = (tensor.detach().numpy().astype(np.float64) for tensor in tensors)
        z = phi(np.concatenate([episode.features for episode in episodes]))
        z_ref = phi(learnt.z_ref) if goal else z.mean(axis=0)
        z_ref, a_ref = reference_inside(z_ref, offset - K @ z_ref, K, np.cov(z.T).reshape(len(Q), len(Q)))
        encoder = learnt.encoder.followed_by(phi.layers)
        drift = drift + A @ z_ref + B @ a_ref - z_ref  # offset of deviations from the reference
        return DistilledPolicy(
            learnt.encoder,
            phi,
            LatentController(encoder, LinearModel(A, B), Q, R, z_ref, a_ref=a_ref, drift=drift),
        )


def _over(missed: Tensor, moved: Tensor, groups: Tensor) -> Tensor:
    """Return the ratio of two sums of squares, averaged over all groups."""
    above, below = (groups.T @ part.square().sum(dim=1) for part in (missed, moved))
    return (above / (below + _LEAST)).mean()
