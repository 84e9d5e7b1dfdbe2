"""The learner of thesis 4.2.4 (Algorithm 2): SAC with a differentiable LQR in its own latent space.

Each update trains the critics and the encoder on the Bellman loss, the encoder on its own loss (Eq. 4.4), and A and B
on the model loss (Eq. 4.7); every other update trains encoder, A, B, Q and R on the actor loss (Eq. 4.10). The model
loss does not train the encoder, because it would collapse the latent states. The actor loss reaches the encoder through
the control only, not through the critics' dependence on z, and excludes convolutions, which dominate the cost. Losses
of disjoint parameters share a backward pass. For images, so do the Bellman loss and the encoder's own loss, scaled to
equal size, because values grow to hundreds and would dominate.

Settings can change this: with critics of observations, only the actor loss and the encoder's own loss train the
encoder, and the model loss may be added to the actor loss with a weight. Since Adam's step size is independent of the
loss scale, a model loss with separate steps affects A and B as strongly as the actor loss.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from itertools import chain
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.agent import Agent
from koopman_lqr_controller.training.networks.critics import make_critic
from koopman_lqr_controller.training.networks.encoder_losses import EncoderBatch, make_encoder_loss, noisy, random_crop
from koopman_lqr_controller.training.networks.networks import TorchEncoder, follow
from koopman_lqr_controller.training.replay import Mirror, Replay, Transitions
from koopman_lqr_controller.training.settings import Settings


class _Batch(NamedTuple):
    """Steps in the form required by the losses.

    Attributes:
        x: Observations (N, *shape); cropped if images.
        u: Actions (N, m).
        x_next: Next observations.
        gained: Discounted rewards before bootstrapping (N,).
        weight: Discount of the bootstrap value (N,).
        x_later: Observations at the bootstrap; `x_next` for one-step returns.
        query: Observations for the encoder's own loss.
        key: The same observations with another augmentation.
    """

    x: Tensor
    u: Tensor
    x_next: Tensor
    gained: Tensor
    weight: Tensor
    x_later: Tensor
    query: Tensor
    key: Tensor


class SoftAgent(Agent):
    """Networks to learn, and their updates.

    Attributes:
        critic: Values of states and actions.
        encoder_loss: The encoder's own loss, or None.
        key_encoder: Momentum encoder of contrastive keys and of the target critic.
        target: Target critic, a slowly updated copy.
        log_temperature: Logarithm of the temperature alpha.
    """

    def __init__(self, interface: AgentInterface, settings: Settings, seed: int, device: str = "cpu") -> None:
        super().__init__(interface, settings, seed, device)
        self.key_encoder = copy.deepcopy(self.actor.encoder).requires_grad_(False)
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(settings.temperature)))
        self._sees_latent = settings.critic_input == "latent"
        self._target_entropy = -float(interface.controls)
        self._images = settings.crop > 0
        self.to(self._device)
        encoder = list(self.actor.encoder.parameters())
        self.optimizers = {
            "critic": self._adam(chain(encoder if self._sees_latent else [], self.critic.parameters())),
            "actor": self._adam(self.actor.parameters()),
            "temperature": self._adam([self.log_temperature]),
        }
        if self.encoder_loss is not None:
            own = self.encoder_loss.parameters()
            self.optimizers["encoder"] = self._adam(own if self._images else chain(encoder, own))
        if self.lqr is not None:
            self.optimizers["model"] = self._adam([self.lqr.A, self.lqr.B])

    def _make_networks(self, interface: AgentInterface) -> None:
        self.critic = make_critic(interface.shape[0], interface.controls, self.settings)
        self.encoder_loss = make_encoder_loss(self.actor.encoder, self.settings)

    def make_replay(self, interface: AgentInterface, capacity: int) -> Replay:
        """Create an empty replay of steps."""
        return Replay(capacity, interface.shape, interface.controls, interface.kind)

    def _scaled_encoders(self) -> Iterable[TorchEncoder]:
        return (self.actor.encoder, self.averaged.encoder, self.key_encoder)

    def act(self, x: NDArray[np.generic], generator: torch.Generator) -> NDArray[np.float32]:
        """Return an action (m,) for an observation (*shape), with exploration noise."""
        with torch.no_grad():
            z = self.actor.encoder(torch.from_numpy(np.asarray(x, np.float32))[None].to(self._device))
            action: NDArray[np.float32] = self.actor.sample(z, generator)[0][0].cpu().numpy()
        return action

    def learn(
        self, replay: Replay, random: np.random.Generator, generator: torch.Generator, mirror: Mirror | None
    ) -> None:
        """Do one update with steps from a replay."""
        settings = self.settings
        steps = replay.draw(settings.batch, random, settings.reward_steps, settings.discount)
        self.update(steps if mirror is None else mirror.mirror_at_random(steps, random), generator)

    def update(self, data: Transitions, generator: torch.Generator) -> None:
        """Train on a batch of steps.

        Args:
            data: Batch of steps.
            generator: Generator of all noise, on the CPU.
        """
        batch, encoder = self._augmented(data, generator), self.actor.encoder
        with torch.set_grad_enabled(self._sees_latent):
            features = encoder.features(batch.x)
            z = encoder.latent(features)
        with torch.no_grad():
            z_next = encoder(batch.x_next)
            z_later = z_next if batch.x_later is batch.x_next else encoder(batch.x_later)
            goal = batch.gained + batch.weight * self._soft_value(z_later, batch.x_later, generator)
        self._learn_values(batch, z, z_next, goal)
        if self.updates % self.settings.actor_every == 0:
            self._learn_law(batch, features, z_next, generator)
            follow(self.target, self.critic, self.settings.critic_rate)
            follow(self.key_encoder, encoder, self.settings.encoder_rate)
        follow(self.averaged, self.actor, self.settings.average_rate)
        self.updates += 1

    def _augmented(self, data: Transitions, generator: torch.Generator) -> _Batch:
        """Return a batch in the form required by the losses: crops of images, and noise for a contrastive loss."""
        x, u, reward, x_next, terminated = (torch.from_numpy(it).to(self._device) for it in data[:5])
        gained, x_later, weight = reward, x_next, self.settings.discount * (1.0 - terminated)
        if data.later is not None:
            gained, x_later, weight = (torch.from_numpy(it).to(self._device) for it in data.later)
        query = key = x
        if self._images:
            query, key = (random_crop(x, self.settings.crop, generator) for _ in range(2))
            x, x_next = query, random_crop(x_next, self.settings.crop, generator)
            x_later = x_next if data.later is None else random_crop(x_later, self.settings.crop, generator)
        elif self.encoder_loss is not None and self.encoder_loss.augments:
            query, key = (noisy(x, self.settings.noise, generator) for _ in range(2))
        return _Batch(x, u, x_next, gained, weight, x_later, query, key)

    def _learn_values(self, batch: _Batch, z: Tensor, z_next: Tensor, goal: Tensor) -> None:
        """Train the critics on targets (N,), the encoder on its own loss, and A and B if they have separate steps."""
        encoder = self.actor.encoder
        losses = {"critic": self.critic.loss(z if self._sees_latent else encoder.normalise(batch.x), batch.u, goal)}
        if self.lqr is not None and not self.settings.model_weight:
            losses["model"] = self.lqr.model_loss(z.detach(), batch.u, z_next)
        if self.encoder_loss is None:
            self._step(losses)
            return
        seen = EncoderBatch(batch.query, batch.key, batch.u, batch.x_next, self.key_encoder, self.lqr)
        if self._images:
            own = self.encoder_loss(z, seen)
            self._step({**losses, "encoder": _as_large_as(losses["critic"], own, z) * own})
        else:
            self._step(losses)
            self._step({"encoder": self.encoder_loss(encoder(batch.query), seen)})

    def _learn_law(self, batch: _Batch, features: Tensor, z_next: Tensor, generator: torch.Generator) -> None:
        """Train the encoder (without convolutions), A, B, Q, R and the temperature on the actor loss."""
        encoder, weight = self.actor.encoder, self.settings.model_weight
        z = encoder.latent(features.detach()) if self._images else encoder(batch.x)
        losses = self._actor_losses(z, batch.x, generator)
        if self.lqr is not None and weight:
            losses["actor"] = losses["actor"] + weight * self.lqr.model_loss(z.detach(), batch.u, z_next)
        self._step(losses)

    def _soft_value(self, z: Tensor, x: Tensor, generator: torch.Generator) -> Tensor:
        """Return the target critics' values of states (N,), with latent states from the key encoder."""
        u, log_density = self.actor.sample(z, generator)
        state = self.key_encoder(x) if self._sees_latent else self.key_encoder.normalise(x)
        return self.target(state, u).amin(dim=0) - self.log_temperature.exp() * log_density

    def _actor_losses(self, z: Tensor, x: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the losses of actor and temperature, which share no parameters."""
        u, log_density = self.actor.sample(z, generator)
        self.critic.requires_grad_(False)
        state = z.detach() if self._sees_latent else self.actor.encoder.normalise(x)
        value = self.critic(state, u).amin(dim=0)
        self.critic.requires_grad_(True)
        self._note({"entropy": -log_density.detach().mean()})
        entropy_gap = (log_density.detach() + self._target_entropy).mean()
        return {
            "actor": (self.log_temperature.exp().detach() * log_density - value).mean(),
            "temperature": -self.log_temperature.exp() * entropy_gap,
        }


def _as_large_as(first: Tensor, second: Tensor, z: Tensor) -> Tensor:
    """Return the factor that scales the second of two losses of z to the first one's gradient size."""
    pulls = (torch.autograd.grad(loss, z, retain_graph=True)[0].norm() for loss in (first, second))
    return next(pulls) / (next(pulls) + torch.finfo(z.dtype).tiny)
