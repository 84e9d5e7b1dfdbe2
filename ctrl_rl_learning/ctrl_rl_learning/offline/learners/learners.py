"""The learners: each takes a batch and makes a step; all of them leave an actor."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from ctrl_rl_core import Actor
from ctrl_rl_learning.offline.learners.settings import LearningSettings
from ctrl_rl_learning.torch.networks import ActorNetwork, Critics, make_mlp
from ctrl_rl_learning.torch.optimization import anneal_lr, gradient_step, polyak_update
from ctrl_rl_learning.torch.td3 import TAU, Td3

_LARGEST_WEIGHT = 20.0
_SAMPLED = 8
Losses = dict[str, Tensor]


class Batch(NamedTuple):
    """Transitions: observations (N, n), actions (N, 2), the others (N,); `terminated` is 0 or 1."""

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    next_observations: Tensor
    terminated: Tensor
    advantages: Tensor


class Learner:
    """Behaviour cloning, and what all learners share.

    Args:
        actor: Untrained policy.
        settings: Settings of learning.

    Attributes:
        actor: Network of the policy as it stands.
    """

    def __init__(self, actor: Actor, settings: LearningSettings) -> None:
        self.settings, self._inputs = settings, len(actor.middle)
        self._optimizers: list[torch.optim.Optimizer] = []
        self.actor = ActorNetwork(actor)
        self._actor_steps = self._adam(self.actor)

    def update(self, batch: Batch) -> Losses:
        """Make a step by a batch and return its losses."""
        return self._clone(batch, torch.ones(len(batch.observations)))

    def anneal(self, done: float) -> None:
        """Set the learning rate when a part of all updates is done, 0 to 1."""
        anneal_lr(self._optimizers, self.settings.rate, done)

    def _clone(self, batch: Batch, weights: Tensor) -> Losses:
        error = ((self.actor(batch.observations) - batch.actions) ** 2).sum(dim=-1)
        loss = (weights * error).mean()
        gradient_step(self._actor_steps, loss)
        return {"actor_loss": loss.detach()}

    def _adam(self, *modules: torch.nn.Module) -> torch.optim.Optimizer:
        parameters = [each for module in modules for each in module.parameters()]
        optimizer = torch.optim.Adam(parameters, lr=self.settings.rate, fused=True)
        self._optimizers.append(optimizer)
        return optimizer


class WeightedCloning(Learner):
    """Cloning of what a value function calls an advantage, in standard deviations (Peng et al. 2019, AWR)."""

    def update(self, batch: Batch) -> Losses:
        """Make a step by a batch and return its losses."""
        return self._clone(batch, _weights(batch.advantages, self.settings))


class CriticLearner(Learner):
    """TD3+BC: the actor climbs its critic and stays near the driver."""

    def __init__(self, actor: Actor, settings: LearningSettings) -> None:
        super().__init__(actor, settings)
        self.critics = Critics(self._inputs, settings.hidden)
        self._td3 = Td3(self.actor, self.critics, self._adam(self.critics))

    def update(self, batch: Batch) -> Losses:
        """Make a step by a batch and return its losses."""
        first, second = self.critics(batch.observations, batch.actions)
        targets = self._targets(batch)
        losses = {"critic_loss": self._td3.learn(first, second, targets, self._penalty(batch, first, second))}
        if self._td3.actors_turn:
            losses |= self._improve(batch)
            self._td3.follow()
        return losses

    def _targets(self, batch: Batch) -> Tensor:
        discounts = self.settings.discount * (1.0 - batch.terminated)
        return self._td3.targets(batch.rewards, discounts, batch.next_observations, batch.actions)

    def _penalty(self, _batch: Batch, _first: Tensor, _second: Tensor) -> Tensor | float:
        return 0.0

    def _improve(self, batch: Batch) -> Losses:
        actions = self.actor(batch.observations)
        q_values, _ = self.critics(batch.observations, actions)
        weight = self.settings.bc_alpha / q_values.detach().abs().mean().clamp(min=1e-6)
        loss = mse_loss(actions, batch.actions) - weight * q_values.mean()
        gradient_step(self._actor_steps, loss)
        return {"actor_loss": loss.detach()}


class ConservativeLearner(CriticLearner):
    """CQL(H): the critic is pushed down at random actions and at the actor's, and up at the driver's."""

    def _penalty(self, batch: Batch, first: Tensor, second: Tensor) -> Tensor | float:
        count = len(batch.observations)
        with torch.no_grad():
            own = self.actor(batch.observations)[:, None] + 0.1 * torch.randn(count, _SAMPLED, 2)
            sampled = torch.cat((torch.rand(count, _SAMPLED, 2) * 2.0 - 1.0, own.clamp(-1.0, 1.0)), dim=1)
        repeated = batch.observations[:, None].expand(-1, 2 * _SAMPLED, -1)
        values = self.critics(repeated, sampled)
        above = torch.logsumexp(values[0], dim=1).mean() + torch.logsumexp(values[1], dim=1).mean()
        return self.settings.conservatism * (above - first.mean() - second.mean())


class ValueCriticLearner(CriticLearner):
    """A critic of what a value function says of reward and state after a command: no bootstrapping."""

    def _targets(self, batch: Batch) -> Tensor:
        return batch.advantages


class ImplicitLearner(Learner):
    """IQL: an expectile of the critic is the value, and cloning is weighted by the advantage over it."""

    def __init__(self, actor: Actor, settings: LearningSettings) -> None:
        super().__init__(actor, settings)
        self.critics = Critics(self._inputs, settings.hidden)
        self._target_critics = copy.deepcopy(self.critics)
        self._value = make_mlp(self._inputs, settings.hidden, 1, normalized=True)
        self._steps = self._adam(self.critics, self._value)

    def update(self, batch: Batch) -> Losses:
        """Make a step by a batch and return its losses."""
        settings = self.settings
        with torch.no_grad():
            q_values = self._target_critics.minimum(batch.observations, batch.actions)
            ahead = self._value(batch.next_observations).squeeze(-1)
            targets = batch.rewards + settings.discount * (1.0 - batch.terminated) * ahead
        advantage = q_values - self._value(batch.observations).squeeze(-1)
        share = torch.where(advantage > 0.0, settings.expectile, 1.0 - settings.expectile)
        first, second = self.critics(batch.observations, batch.actions)
        loss = (share * advantage**2).mean() + mse_loss(first, targets) + mse_loss(second, targets)
        gradient_step(self._steps, loss)
        polyak_update(self._target_critics, self.critics, TAU)
        return {"critic_loss": loss.detach(), **self._clone(batch, _weights(advantage.detach(), settings))}


LEARNERS: dict[str, Callable[[Actor, LearningSettings], Learner]] = {
    "bc": Learner,
    "td3bc": CriticLearner,
    "iql": ImplicitLearner,
    "cql": ConservativeLearner,
    "value_weight": WeightedCloning,
    "value_model": WeightedCloning,
    "value_critic": ValueCriticLearner,
}


def _weights(advantages: Tensor, settings: LearningSettings) -> Tensor:
    """Return the weights (N,) of cloning by advantages (N,)."""
    return torch.exp(advantages / settings.weight_temperature).clamp(max=_LARGEST_WEIGHT)
