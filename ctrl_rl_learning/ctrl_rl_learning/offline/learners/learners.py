"""The learners: each takes a batch and makes a step; all of them leave an actor."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from ctrl_rl_learning.offline.learners.networks import ActorNetwork, Critics, make_mlp, track
from ctrl_rl_learning.offline.learners.settings import LearningSettings

_TAU = 0.005
_NOISE, _NOISE_LIMIT, _DELAY = 0.2, 0.5, 2  # TD3's
_LARGEST_WEIGHT = 20.0
_SAMPLED = 8


class Batch(NamedTuple):
    """Transitions: observations (N, n), actions (N, 2), rewards (N,), next observations, ends (0 or 1), advantages."""

    seen: Tensor
    done: Tensor
    paid: Tensor
    following: Tensor
    ended: Tensor
    advantage: Tensor


class Learner:
    """Behaviour cloning, and what all learners share.

    Attributes:
        actor: Policy as it stands.
    """

    def __init__(self, inputs: int, settings: LearningSettings) -> None:
        self.settings = settings
        self._optimizers: list[torch.optim.Optimizer] = []
        self.actor = ActorNetwork(inputs, settings.hidden)
        self._actor_steps = self._adam(self.actor)
        self._count = 0

    def update(self, batch: Batch) -> None:
        """Make a step by a batch."""
        self._count += 1
        self._clone(batch, torch.ones(len(batch.seen)))

    def slow_down(self, part: float) -> None:
        """Set the learning rate for a part of all updates that is over, 0 to 1: it falls along a half cosine to 0."""
        for optimizer in self._optimizers:
            for group in optimizer.param_groups:
                group["lr"] = 0.5 * (1.0 + math.cos(math.pi * part)) * self.settings.rate

    def _clone(self, batch: Batch, weights: Tensor) -> None:
        error = ((self.actor(batch.seen) - batch.done) ** 2).sum(dim=-1)
        _step(self._actor_steps, (weights * error).mean())

    def _adam(self, *modules: torch.nn.Module) -> torch.optim.Optimizer:
        parameters = [each for module in modules for each in module.parameters()]
        optimizer = torch.optim.Adam(parameters, lr=self.settings.rate, fused=True)
        self._optimizers.append(optimizer)
        return optimizer


class WeightedCloning(Learner):
    """Cloning of what a value function calls an advantage, in standard deviations (Peng et al. 2019, AWR)."""

    def update(self, batch: Batch) -> None:
        """Make a step by a batch."""
        weights = torch.exp(batch.advantage / self.settings.heat).clamp(max=_LARGEST_WEIGHT)
        self._clone(batch, weights)


class CriticLearner(Learner):
    """TD3+BC: the actor climbs its critic and stays near the driver."""

    def __init__(self, inputs: int, settings: LearningSettings) -> None:
        super().__init__(inputs, settings)
        self.critics = Critics(inputs, settings.hidden)
        self._slow_critics, self._slow_actor = copy.deepcopy(self.critics), copy.deepcopy(self.actor)
        self._critic_steps = self._adam(self.critics)

    def update(self, batch: Batch) -> None:
        """Make a step by a batch."""
        self._count += 1
        first, second = self.critics(batch.seen, batch.done)
        target = self._target(batch)
        loss = mse_loss(first, target) + mse_loss(second, target) + self._penalty(batch, first, second)
        _step(self._critic_steps, loss)
        if self._count % _DELAY == 0:
            self._improve(batch)
            track(self._slow_critics, self.critics, _TAU)
            track(self._slow_actor, self.actor, _TAU)

    def _target(self, batch: Batch) -> Tensor:
        with torch.no_grad():
            noise = (_NOISE * torch.randn_like(batch.done)).clamp(-_NOISE_LIMIT, _NOISE_LIMIT)
            actions = (self._slow_actor(batch.following) + noise).clamp(-1.0, 1.0)
            worth = self._slow_critics.least(batch.following, actions)
            return batch.paid + self.settings.discount * (1.0 - batch.ended) * worth

    def _penalty(self, _batch: Batch, _first: Tensor, _second: Tensor) -> Tensor | float:
        return 0.0

    def _improve(self, batch: Batch) -> None:
        actions = self.actor(batch.seen)
        worth, _ = self.critics(batch.seen, actions)
        greed = self.settings.greed / worth.detach().abs().mean().clamp(min=1e-6)
        _step(self._actor_steps, mse_loss(actions, batch.done) - greed * worth.mean())


class ConservativeLearner(CriticLearner):
    """CQL(H): the critic is pushed down at random actions and at the actor's, and up at the driver's."""

    def _penalty(self, batch: Batch, first: Tensor, second: Tensor) -> Tensor | float:
        count = len(batch.seen)
        with torch.no_grad():
            own = self.actor(batch.seen)[:, None] + 0.1 * torch.randn(count, _SAMPLED, 2)
            sampled = torch.cat((torch.rand(count, _SAMPLED, 2) * 2.0 - 1.0, own.clamp(-1.0, 1.0)), dim=1)
        repeated = batch.seen[:, None].expand(-1, 2 * _SAMPLED, -1)
        values = self.critics(repeated, sampled)
        above = torch.logsumexp(values[0], dim=1).mean() + torch.logsumexp(values[1], dim=1).mean()
        return self.settings.conservatism * (above - first.mean() - second.mean())


class ValueCriticLearner(CriticLearner):
    """A critic of what a value function says of reward and state after a command: no bootstrapping."""

    def _target(self, batch: Batch) -> Tensor:
        return batch.advantage


class ImplicitLearner(Learner):
    """IQL: an expectile of the critic is the value, and cloning is weighted by the advantage over it."""

    def __init__(self, inputs: int, settings: LearningSettings) -> None:
        super().__init__(inputs, settings)
        self.critics = Critics(inputs, settings.hidden)
        self._slow_critics = copy.deepcopy(self.critics)
        self._value = make_mlp(inputs, settings.hidden, 1, normalized=True)
        self._steps = self._adam(self.critics, self._value)

    def update(self, batch: Batch) -> None:
        """Make a step by a batch."""
        settings = self.settings
        with torch.no_grad():
            worth = self._slow_critics.least(batch.seen, batch.done)
            following = self._value(batch.following).squeeze(-1)
            target = batch.paid + settings.discount * (1.0 - batch.ended) * following
        advantage = worth - self._value(batch.seen).squeeze(-1)
        share = torch.where(advantage > 0.0, settings.expectile, 1.0 - settings.expectile)
        first, second = self.critics(batch.seen, batch.done)
        loss = (share * advantage**2).mean() + mse_loss(first, target) + mse_loss(second, target)
        _step(self._steps, loss)
        track(self._slow_critics, self.critics, _TAU)
        weights = torch.exp(advantage.detach() / settings.heat).clamp(max=_LARGEST_WEIGHT)
        self._clone(batch, weights)


LEARNERS: dict[str, Callable[[int, LearningSettings], Learner]] = {
    "bc": Learner,
    "td3bc": CriticLearner,
    "iql": ImplicitLearner,
    "cql": ConservativeLearner,
    "value_weight": WeightedCloning,
    "value_model": WeightedCloning,
    "value_critic": ValueCriticLearner,
}


def _step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
