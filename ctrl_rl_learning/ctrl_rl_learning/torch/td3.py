"""The critics of TD3 and both target networks (Fujimoto, van Hoof, Meger 2018), for all that climb a learnt critic."""

from __future__ import annotations

import copy

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from ctrl_rl_learning.torch.networks import ActorNetwork, Critics
from ctrl_rl_learning.torch.optimization import gradient_step, polyak_update

TAU = 0.005
"""Share by which a target network follows at an update."""
_NOISE, _NOISE_LIMIT, _DELAY = 0.2, 0.5, 2


class Td3:
    """Two critics that learn from targets of slower networks; the actor's turn is every other update.

    Args:
        actor: Policy, from observations (N, n) to actions (N, m).
        critics: Critics of the policy.
        optimizer: Optimiser of the critics.

    Attributes:
        target_actor: Policy averaged over its last updates.
        target_critics: Critics averaged over theirs.
        updates: Number of updates of the critics so far.
    """

    def __init__(self, actor: ActorNetwork, critics: Critics, optimizer: torch.optim.Optimizer) -> None:
        self._actor, self._critics, self._optimizer = actor, critics, optimizer
        self.target_actor, self.target_critics = copy.deepcopy(actor), copy.deepcopy(critics)
        self.updates = 0

    def targets(self, rewards: Tensor, discounts: Tensor, next_observations: Tensor, actions: Tensor) -> Tensor:
        """Return rewards (N,) and the discounted value of what follows, by the target networks.

        The target's actions have noise of the shape of `actions` (N, m), so that the critics are smooth.
        """
        with torch.no_grad():
            noise = (_NOISE * torch.randn_like(actions)).clamp(-_NOISE_LIMIT, _NOISE_LIMIT)
            ahead = (self.target_actor(next_observations) + noise).clamp(-1.0, 1.0)
            return rewards + discounts * self.target_critics.minimum(next_observations, ahead)

    def learn(self, first: Tensor, second: Tensor, targets: Tensor, penalty: Tensor | float = 0.0) -> Tensor:
        """Move both critics' values (N,) towards targets (N,), and return the loss."""
        loss = mse_loss(first, targets) + mse_loss(second, targets) + penalty
        gradient_step(self._optimizer, loss)
        self.updates += 1
        return loss.detach()

    @property
    def actors_turn(self) -> bool:
        """Whether the actor improves after this update."""
        return self.updates % _DELAY == 0

    def follow(self, *, actor: bool = True) -> None:
        """Let the target networks follow, that of the actor only where it has learnt."""
        polyak_update(self.target_critics, self._critics, TAU)
        if actor:
            polyak_update(self.target_actor, self._actor, TAU)
