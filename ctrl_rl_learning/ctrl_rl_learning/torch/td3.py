"""Critics and target networks of TD3 (Fujimoto, van Hoof, Meger 2018), for every learner that uses them."""

from __future__ import annotations

import copy

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from ctrl_rl_learning.torch.networks import ActorNetwork, Critics
from ctrl_rl_learning.torch.optimization import gradient_step, polyak_update

TAU = 0.005
"""Polyak step of the target networks per update."""
_NOISE, _NOISE_LIMIT, _DELAY = 0.2, 0.5, 2


class Td3:
    """Twin critics that learn from target networks, with an actor update after every other critic update.

    Args:
        actor: Policy, from observations (N, n) to actions (N, m).
        critics: Critics of the policy.
        optimizer: Optimiser of the critics.

    Attributes:
        target_actor: Policy averaged over its last updates.
        target_critics: Critics averaged over their last updates.
        updates: Number of critic updates so far.
    """

    def __init__(self, actor: ActorNetwork, critics: Critics, optimizer: torch.optim.Optimizer) -> None:
        self._actor, self._critics, self._optimizer = actor, critics, optimizer
        self.target_actor, self.target_critics = copy.deepcopy(actor), copy.deepcopy(critics)
        self.updates = 0

    def targets(self, rewards: Tensor, discounts: Tensor, next_observations: Tensor, actions: Tensor) -> Tensor:
        """Return the targets (N,): rewards plus the discounted value of the next observations by the target networks.

        Noise on the target actions, shaped like `actions` (N, m), smooths the critics.
        """
        with torch.no_grad():
            noise = (_NOISE * torch.randn_like(actions)).clamp(-_NOISE_LIMIT, _NOISE_LIMIT)
            ahead = (self.target_actor(next_observations) + noise).clamp(-1.0, 1.0)
            return rewards + discounts * self.target_critics.minimum(next_observations, ahead)

    def learn(self, first: Tensor, second: Tensor, targets: Tensor, penalty: Tensor | float = 0.0) -> Tensor:
        """Update both critics, whose values are given (N,), towards targets (N,); return the loss."""
        loss = mse_loss(first, targets) + mse_loss(second, targets) + penalty
        gradient_step(self._optimizer, loss)
        self.updates += 1
        return loss.detach()

    @property
    def actors_turn(self) -> bool:
        """Whether the actor is updated after this critic update."""
        return self.updates % _DELAY == 0

    def follow(self, *, actor: bool = True) -> None:
        """Update the target networks, the actor's only if `actor` is set."""
        polyak_update(self.target_critics, self._critics, TAU)
        if actor:
            polyak_update(self.target_actor, self._actor, TAU)
