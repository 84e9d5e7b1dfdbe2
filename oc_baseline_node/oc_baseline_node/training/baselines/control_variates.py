"""PPO with action-dependent baselines, for comparison as in the thesis (Fig. 3.13).

A baseline c(s, a) shifts the mean of the gradient, so the difference is added back through the policy, with
a = f_theta(s, xi) = mu_theta(s) + sigma_theta xi (Stein's identity; in Q-Prop c is linear in a):

    grad J = E[ grad log pi(a|s) (A(s, a) - c(s, a)) + grad_a c(s, a) grad_theta f_theta(s, xi) ]
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from ctrl_rl_learning.sb3 import NormalizedTanh
from ctrl_rl_learning.torch import gradient_step
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.utils import polyak_update
from torch import nn

from oc_baseline_node.training.baselines.policy_gradient import BaselineBuffer

HIDDEN = (64, 64)
LEARNING_RATE = 1e-3


class ControlVariatePpo(PPO):
    """PPO with a baseline c(s, a); subclasses define c and its training.

    Attributes:
        critic: Network of c.
        critic_optimizer: Optimizer of the critic's weights.
        through_noise: Whether f_theta includes sigma_theta xi, or only mu_theta.
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
        """Return c (N,) and its slope grad_a c (N, m), detached."""

    def fit_before(self) -> None:
        """Train c on the roll-out before the policy update."""

    def fit_after(self) -> None:
        """Train c on the roll-out after the policy update."""

    def train(self) -> None:
        """Train on the roll-out: PPO's clipped loss with A - c, plus the correction term for c."""
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
                # As in PPO's own gradient, the term is dropped where the clipped surrogate is smaller.
                counted = (free <= clipped).float().detach()
                given_back = counted * (slope[part] * reached).sum(dim=1) / scale
                assert entropy is not None
                loss = (
                    -(surrogate + given_back).mean()
                    - self.ent_coef * entropy.mean()
                    + self.vf_coef * nn.functional.mse_loss(values.flatten(), data.returns[part])
                )
                gradient_step(self.policy.optimizer, loss, self.policy.parameters(), largest_norm=self.max_grad_norm)
        self._n_updates += self.n_epochs
        self.fit_after()

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, variables = super()._get_torch_save_params()
        return [*modules, "critic", "critic_optimizer"], variables


def make_critic(inputs: int) -> nn.Sequential:
    """Create a network of the policy's shape with one output."""
    sizes: Sequence[int] = (inputs, *HIDDEN)
    layers = [part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), NormalizedTanh())]
    return nn.Sequential(*layers, nn.Linear(HIDDEN[-1], 1))


def value_and_slope(
    critic: nn.Module, observations: torch.Tensor, actions: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a critic's detached values (N,) and their gradients with respect to the actions (N, m)."""
    actions = actions.detach().clone().requires_grad_()
    values = critic(torch.cat((observations, actions), dim=1)).flatten()
    (slope,) = torch.autograd.grad(values.sum(), actions)
    return values.detach(), slope


def standardised(signal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Standardise a signal (N,) to mean 0 and standard deviation 1; return it with its scale."""
    scale = signal.std() + 1e-8
    return (signal - signal.mean()) / scale, scale


_UPDATES = 512
"""Number of critic updates per roll-out."""
_BATCH = 128
_TAU = 0.005


class QPropPpo(ControlVariatePpo):
    """PPO with the control variate of Q-Prop.

    The conservative variant of Gu et al., "Q-Prop: Sample-Efficient Policy Gradient with An Off-Policy Critic", ICLR
    2017: a Taylor expansion around mu(s) of an off-policy critic Q_w, which learns from a replay of all samples so far:
    c(s, a) = eta(s) grad_a Q_w(s, mu) (a - mu), where eta = 1 if A and grad_a Q_w (a - mu) agree in sign, else 0.

    Args:
        replay_size: Capacity in samples; should hold all samples of the run.

    Attributes:
        replay_buffer: All samples so far.
        target: Target critic, which tracks `critic`.
    """

    through_noise = False

    def __init__(self, *arguments: Any, replay_size: int, **others: Any) -> None:
        self._replay_size = replay_size
        super().__init__(*arguments, **others)

    def _setup_model(self) -> None:
        super()._setup_model()
        self.target = copy.deepcopy(self.critic)
        self.replay_buffer = ReplayBuffer(
            self._replay_size, self.observation_space, self.action_space, "cpu", n_envs=self.n_envs
        )

    def variate(
        self, observations: torch.Tensor, actions: torch.Tensor, advantages: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return eta grad_a Q (a - mu) (N,) and eta grad_a Q (N, m)."""
        mean = self._mean(observations)
        _, slope = value_and_slope(self.critic, observations, mean)
        expansion = (slope * (actions - mean)).sum(dim=1)
        eta = (advantages * expansion > 0.0).float()
        return eta * expansion, eta[:, None] * slope

    def fit_before(self) -> None:
        """Add the roll-out to the replay and train Q_w on it, as in DDPG."""
        self._remember()
        for _ in range(_UPDATES):
            data = self.replay_buffer.sample(_BATCH)
            with torch.no_grad():
                ahead = self.target(torch.cat((data.next_observations, self._mean(data.next_observations)), dim=1))
                aim = data.rewards + self.gamma * (1.0 - data.dones) * ahead
            found = self.critic(torch.cat((data.observations, data.actions), dim=1))
            loss = nn.functional.mse_loss(found, aim)
            gradient_step(self.critic_optimizer, loss)
            polyak_update(self.critic.parameters(), self.target.parameters(), _TAU)

    def _remember(self) -> None:
        """Add the roll-out to the replay; rewards already include the bootstrap at a time-out."""
        buffer = self.rollout_buffer
        assert isinstance(self._last_obs, np.ndarray)
        assert self._last_episode_starts is not None
        following = np.concatenate((buffer.observations[1:], self._last_obs[None]))
        ended = np.concatenate((buffer.episode_starts[1:], self._last_episode_starts[None]))
        for step in range(buffer.buffer_size):
            self.replay_buffer.add(
                buffer.observations[step],
                following[step],
                buffer.actions[step],
                buffer.rewards[step],
                ended[step],
                [{}] * self.n_envs,
            )

    def _mean(self, observations: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            distribution: Any = self.policy.get_distribution(observations).distribution
            mean: torch.Tensor = distribution.mean
            return mean

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, variables = super()._get_torch_save_params()
        return [*modules, "target"], variables


class SteinPpo(ControlVariatePpo):
    """PPO with the Stein control variate.

    c(s, a) = psi_w(s, a) in addition to the learnt V(s), fitted to the advantages ("FitQ"): Liu et al.,
    "Action-dependent Control Variates for Policy Optimization via Stein's Identity", ICLR 2018. psi is fitted after the
    policy update, for use on the next roll-out: if fitted before, it would depend on the actions from which it is
    subtracted, and Stein's identity would not hold.
    """

    def variate(
        self, observations: torch.Tensor, actions: torch.Tensor, _: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return psi (N,) and its slope (N, m)."""
        return value_and_slope(self.critic, observations, actions)

    def fit_after(self) -> None:
        """Fit psi to the roll-out's advantages."""
        for _ in range(self.n_epochs):
            for data in self.rollout_buffer.get(self.batch_size):
                found = self.critic(torch.cat((data.observations, data.actions), dim=1)).flatten()
                loss = nn.functional.mse_loss(found, data.advantages)
                gradient_step(self.critic_optimizer, loss)
