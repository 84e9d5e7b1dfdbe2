"""PPO with a baseline that depends on the action too: what the thesis compares with (Fig. 3.13).

Such a baseline c(s, a) does shift the gradient's mean, so that what it takes away is given back through the policy,
with a = f_theta(s, xi) = mu_theta(s) + sigma_theta xi (Stein's identity; in Q-Prop c is linear in a):

    grad J = E[ grad log pi(a|s) (A(s, a) - c(s, a)) + grad_a c(s, a) grad_theta f_theta(s, xi) ]
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
from ctrl_rl_learning.sb3.algorithms import NormalizedTanh
from stable_baselines3 import PPO
from torch import nn

from oc_baseline_node.training.baselines.policy_gradient import BaselineBuffer

HIDDEN = (64, 64)
LEARNING_RATE = 1e-3


class ControlVariatePpo(PPO):
    """PPO with c(s, a); a subclass says what c is and how it is learnt.

    Attributes:
        critic: network of c.
        critic_optimizer: Optimizer of the critic's weights.
        through_noise: whether f_theta goes through sigma_theta xi too, or through mu_theta alone.
    """

    rollout_buffer: BaselineBuffer
    through_noise = True

    def _setup_model(self) -> None:
        super()._setup_model()
        assert self.observation_space.shape is not None
        assert self.action_space.shape is not None
        self.critic = make_critic(self.observation_space.shape[0] + self.action_space.shape[0])
        self.critic_optimizer = torch.optim.Adam(self.critic.parameters(), lr=LEARNING_RATE)

    @abstractmethod
    def variate(
        self, observations: torch.Tensor, actions: torch.Tensor, advantages: torch.Tensor, /
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return c (N,) and its slope grad_a c (N, m), without gradients."""

    def fit_before(self) -> None:
        """Learn c from the roll-out before the policy does."""

    def fit_after(self) -> None:
        """Learn c from the roll-out after the policy has."""

    def train(self) -> None:
        """Learn from the roll-out: PPO's clipped loss with A - c, and what gives c back."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        self.fit_before()
        clip = float(self.clip_range(self._current_progress_remaining))  # type: ignore[operator]
        data = next(self.rollout_buffer.get())
        c, slope = self.variate(data.observations, data.actions, data.advantages)
        with torch.no_grad():
            before: Any = self.policy.get_distribution(data.observations).distribution
            noise = (data.actions - before.mean) / before.stddev
        for _ in range(self.n_epochs):
            for part in torch.split(torch.randperm(len(c)), self.batch_size):
                values, log_probability, entropy = self.policy.evaluate_actions(
                    data.observations[part], data.actions[part]
                )
                left, scale = standardised(data.advantages[part] - c[part])
                ratio = torch.exp(log_probability - data.old_log_prob[part])
                free, clipped = left * ratio, left * ratio.clamp(1.0 - clip, 1.0 + clip)
                surrogate = torch.min(free, clipped)
                now: Any = self.policy.get_distribution(data.observations[part]).distribution
                reached = now.mean + now.stddev * noise[part] if self.through_noise else now.mean
                # What is given back ends where PPO's own gradient does: where the clipped surrogate is the smaller.
                counted = (free <= clipped).float().detach()
                given_back = counted * (slope[part] * reached).sum(dim=1) / scale
                assert entropy is not None
                loss = (
                    -(surrogate + given_back).mean()
                    - self.ent_coef * entropy.mean()
                    + self.vf_coef * nn.functional.mse_loss(values.flatten(), data.returns[part])
                )
                self.policy.optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
                self.policy.optimizer.step()
        self._n_updates += self.n_epochs
        self.fit_after()

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, variables = super()._get_torch_save_params()
        return [*modules, "critic", "critic_optimizer"], variables


def make_critic(inputs: int) -> nn.Sequential:
    """Return a network of the policy's shape with one output."""
    sizes: Sequence[int] = (inputs, *HIDDEN)
    layers = [part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), NormalizedTanh())]
    return nn.Sequential(*layers, nn.Linear(HIDDEN[-1], 1))


def value_and_slope(
    critic: nn.Module, observations: torch.Tensor, actions: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a critic's values (N,) and their gradients by the actions (N, m), without gradients of their own."""
    actions = actions.detach().clone().requires_grad_()
    values = critic(torch.cat((observations, actions), dim=1)).flatten()
    (slope,) = torch.autograd.grad(values.sum(), actions)
    return values.detach(), slope


def standardised(signal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a signal (N,) with mean 0 and standard deviation 1, and what it was divided by."""
    scale = signal.std() + 1e-8
    return (signal - signal.mean()) / scale, scale
