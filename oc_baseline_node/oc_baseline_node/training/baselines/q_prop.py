"""Q-Prop, the conservative one: a Taylor expansion of an off-policy critic as control variate.

Gu et al., "Q-Prop: Sample-Efficient Policy Gradient with An Off-Policy Critic", ICLR 2017. An
off-policy critic Q_w, learnt from a replay of all samples so far, is expanded around mu(s):
c(s, a) = eta(s) grad_a Q_w(s, mu) (a - mu), where eta = 1 where A and grad_a Q_w (a - mu) agree in sign, else 0.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.utils import polyak_update
from torch import nn

from oc_baseline_node.training.baselines.control_variates import ControlVariatePpo, value_and_slope

_UPDATES = 512
"""Number of the critic's updates for each roll-out."""
_BATCH = 128
_TAU = 0.005


class QPropPpo(ControlVariatePpo):
    """PPO with the control variate of Q-Prop.

    Args:
        replay_size: samples it keeps; give as many as there will be.

    Attributes:
        replay_buffer: all samples so far.
        target: the critic that targets are made with; it follows `critic`.
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
        """Add the roll-out to the replay and learn Q_w from it, as DDPG does."""
        self._remember()
        for _ in range(_UPDATES):
            data = self.replay_buffer.sample(_BATCH)
            with torch.no_grad():
                ahead = self.target(torch.cat((data.next_observations, self._mean(data.next_observations)), dim=1))
                aim = data.rewards + self.gamma * (1.0 - data.dones) * ahead
            found = self.critic(torch.cat((data.observations, data.actions), dim=1))
            loss = nn.functional.mse_loss(found, aim)
            self.critic_optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self.critic_optimizer.step()
            polyak_update(self.critic.parameters(), self.target.parameters(), _TAU)

    def _remember(self) -> None:
        """Put the roll-out into the replay; a time-out's bootstrap is part of its reward already."""
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
