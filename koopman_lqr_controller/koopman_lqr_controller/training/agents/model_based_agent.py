"""The differentiable LQR with values and a representation in the style of MR.Q (Fujimoto et al. 2025).

A multi-step model trains the encoder's features and an embedding of features with actions, the only input of the
values. The actor maps the features to z by its own layers, and its loss trains these, A, B, Q and R. The representation
therefore learns from every step, the values from a temporarily fixed representation, and the law from both.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from itertools import chain
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from koopman_lqr_controller.training.agents.actor import AgentInterface
from koopman_lqr_controller.training.agents.agent import Agent
from koopman_lqr_controller.training.agents.cuda_graph import Graphed
from koopman_lqr_controller.training.networks.critics import TwinCritic
from koopman_lqr_controller.training.networks.networks import TorchEncoder, follow
from koopman_lqr_controller.training.networks.representation import Representation
from koopman_lqr_controller.training.replay import Mirror, Replay, SequenceReplay
from koopman_lqr_controller.training.settings import Settings

_CRITIC_DEPTH = 3
_REPRESENTATION_SHARE = 1.0 / 3.0
"""Learning rate of the representation relative to that of values and actor."""
_TARGET_NOISE, _LARGEST_TARGET_NOISE = 0.2, 0.3
"""Standard deviation and bound of the noise added to the target's actions (TD3; Fujimoto et al. 2018)."""
_PRIORITY_POWER = 0.4
_LEAST_ERROR = 1.0
"""Value error, in units of the reward scale, below which all samples are drawn equally often."""
_LEAST_REWARD_SCALE = 1e-8
"""Reward scale while all rewards have been zero: the first ones count from the next target update on, with a scale of
their own, since relative to this one they would ruin the critic."""
_INPUT_WEIGHT = 1e-5
"""Weight of the squared u before tanh, which keeps u from drifting where tanh is flat."""


class _Batch(NamedTuple):
    """Sequences of H steps in the form required by the losses."""

    x: Tensor
    u: Tensor
    reward: Tensor
    goes_on: Tensor


class ModelBasedAgent(Agent):
    """Networks to learn, and their updates.

    Attributes:
        representation: Embedding of the encoder's features with actions, and its model.
        critic: Values of the embeddings, in units of `reward_scale`.
        target_actor: Actor with its encoder at the last target update, but with the current observation scale.
        target_representation: Representation at the last target update.
        target_critic: Critic at the last target update.
        reward_scale: Mean absolute reward at the last two target updates (2,).
    """

    reward_scale: Tensor

    def __init__(self, interface: AgentInterface, settings: Settings, seed: int, device: str = "cpu") -> None:
        super().__init__(interface, settings, seed, device)
        self.target_actor = copy.deepcopy(self.actor).requires_grad_(False)
        self.target_representation = copy.deepcopy(self.representation).requires_grad_(False)
        self.target_critic = copy.deepcopy(self.critic).requires_grad_(False)
        self.register_buffer("reward_scale", torch.zeros(2))
        self.to(self._device)
        encoder = self.actor.encoder
        law = [p for name, p in self.actor.named_parameters() if not name.startswith("encoder.")]
        self.optimizers = {
            "representation": self._adam(
                chain(encoder.body.parameters(), self.representation.parameters()),
                _REPRESENTATION_SHARE * settings.learning_rate,
            ),
            "critic": self._adam(self.critic.parameters()),
            "actor": self._adam(chain(encoder.head.parameters(), law)),
        }
        self._mean = Graphed(self._squashed_mean, self._device)
        self._learn_representation = Graphed(self._improve_representation, self._device)
        self._learn_values_and_law = Graphed(self._improve_values_and_law, self._device)

    def _make_networks(self, interface: AgentInterface) -> None:
        settings, halved = self.settings, self.settings.bfloat16 == "all"
        self.representation = Representation(settings.hidden, interface.controls, settings.hidden, halved)
        self.critic = TwinCritic(
            settings.hidden, 0, settings.hidden, normalised=True, halved=halved, depth=_CRITIC_DEPTH
        )

    def make_replay(self, interface: AgentInterface, capacity: int) -> SequenceReplay:
        """Create an empty replay of sequences."""
        return SequenceReplay(capacity, interface.shape, interface.controls, interface.kind, self.settings.model_steps)

    def _scaled_encoders(self) -> Iterable[TorchEncoder]:
        return (self.actor.encoder, self.averaged.encoder, self.target_actor.encoder)

    def act(self, x: NDArray[np.generic], generator: torch.Generator) -> NDArray[np.float32]:
        """Return an action (m,) for an observation (*shape), with exploration noise."""
        u = self._mean(torch.from_numpy(np.asarray(x, np.float32))[None])[0].cpu()
        noise = self.settings.exploration * torch.randn(u.shape, generator=generator)
        action: NDArray[np.float32] = (u + noise).clamp(-1.0, 1.0).numpy()
        return action

    @torch.no_grad()
    def _squashed_mean(self, x: Tensor) -> Tensor:
        return torch.tanh(self.actor.mean(self.actor.encoder(x)))

    def learn(
        self, replay: Replay, random: np.random.Generator, generator: torch.Generator, mirror: Mirror | None
    ) -> None:
        """Do one update; at a target update, first train the representation as often as the targets are kept."""
        assert isinstance(replay, SequenceReplay)
        if not replay.ready:
            return
        if self.updates % self.settings.renewal == 0:
            self._renew_targets(replay)
            for _ in range(self.settings.renewal):
                self._learn_representation(*self._draw(replay, random, mirror)[1])
        place, batch = self._draw(replay, random, mirror)
        noise = _TARGET_NOISE * torch.randn(batch.u[:, 0].shape, generator=generator)
        errors = self._learn_values_and_law(*batch, noise.clamp(-_LARGEST_TARGET_NOISE, _LARGEST_TARGET_NOISE))
        replay.set_priority(place, errors.clamp(min=_LEAST_ERROR).pow(_PRIORITY_POWER).cpu().numpy())
        self.updates += 1

    def _draw(
        self, replay: SequenceReplay, random: np.random.Generator, mirror: Mirror | None
    ) -> tuple[NDArray[np.intp], _Batch]:
        """Return sampled sequences and their indices in the replay (N,)."""
        drawn = replay.draw_sequences(self.settings.batch, random)
        if mirror is not None:
            drawn = mirror.mirror_sequences_at_random(drawn, random)
        x, u, reward, terminated = (torch.from_numpy(it) for it in drawn[1:])
        return drawn.place, _Batch(x, u, reward, 1.0 - terminated)

    def _renew_targets(self, replay: SequenceReplay) -> None:
        follow(self.target_actor, self.actor, 1.0)
        follow(self.target_representation, self.representation, 1.0)
        follow(self.target_critic, self.critic, 1.0)
        scale = max(float(np.abs(replay.everything().reward).mean()), _LEAST_REWARD_SCALE)
        self.reward_scale.copy_(torch.tensor([scale, float(self.reward_scale[0])]))

    def _improve_representation(self, *tensors: Tensor) -> Tensor:
        """Train the representation on a batch; return its loss."""
        batch, encoder, target = _Batch(*tensors), self.actor.encoder, self.target_actor.encoder
        with torch.no_grad():
            later = target.features(batch.x[:, 1:].flatten(0, 1)).float().reshape(*batch.u.shape[:2], -1)
        features = encoder.features(batch.x[:, 0])
        loss = self.representation.loss(features, batch.u, batch.reward, later, batch.goes_on)
        self._step({"representation": loss})
        return loss.detach()

    def _improve_values_and_law(self, *tensors: Tensor) -> Tensor:
        """Train critic and law on a batch with noise (N, m) on the target's actions; return the value errors (N,)."""
        batch = _Batch(*tensors[:-1])
        with torch.no_grad():
            features = self.actor.encoder.features(batch.x[:, 0])
        errors = self._learn_values(batch, features, tensors[-1])
        self._learn_law(batch, features)
        follow(self.averaged, self.actor, self.settings.average_rate)
        return errors

    def _learn_values(self, batch: _Batch, features: Tensor, noise: Tensor) -> Tensor:
        """Train the critic on multi-step targets; return the larger error of the two values (N,)."""
        with torch.no_grad():
            goal = self._goal(batch, noise)
            pair = self.representation(features, batch.u[:, 0])
        values = self.critic.values(pair)
        self._step({"critic": smooth_l1_loss(values, goal.expand(2, -1))})
        return (values.detach() - goal).abs().amax(dim=0)

    def _goal(self, batch: _Batch, noise: Tensor) -> Tensor:
        """Return the multi-step value target (N,), in units of the reward scale."""
        settings, actor = self.settings, self.target_actor
        scale, scale_before = self.reward_scale
        gained, weight = torch.zeros(len(batch.u), device=self._device), torch.ones(len(batch.u), device=self._device)
        for step in range(settings.reward_steps):
            gained = gained + weight * batch.reward[:, step]
            weight = weight * settings.discount * batch.goes_on[:, step]
        features = actor.encoder.features(batch.x[:, settings.reward_steps])
        u = (torch.tanh(actor.mean(actor.encoder.latent(features))) + noise).clamp(-1.0, 1.0)
        value = self.target_critic.values(self.target_representation(features, u)).amin(dim=0)
        goal = (gained + weight * value * scale_before) / scale
        return torch.where(scale > _LEAST_REWARD_SCALE, goal, torch.zeros_like(goal))

    def _learn_law(self, batch: _Batch, features: Tensor) -> None:
        """Train z, A, B, Q and R (or the network in their place) to maximise the values of their actions."""
        encoder, weight = self.actor.encoder, self.settings.model_weight
        z = encoder.latent(features)
        u = self.actor.mean(z)
        judges = nn.ModuleList((self.representation, self.critic)).requires_grad_(False)
        loss = -self.critic.values(self.representation(features, torch.tanh(u))).mean()
        judges.requires_grad_(True)
        loss = loss + _INPUT_WEIGHT * u.square().mean()
        if self.lqr is not None and weight:
            with torch.no_grad():
                z_next = encoder(batch.x[:, 1])
            model_loss = self.lqr.model_loss(z.detach(), batch.u[:, 0], z_next)
            loss = loss + weight * model_loss
        self._step({"actor": loss})
