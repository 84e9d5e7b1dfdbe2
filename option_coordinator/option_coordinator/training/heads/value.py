"""The centralised value network V(s_kappa), and the scale of its targets."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from option_coordinator.options.decision import NONE
from option_coordinator.training.heads.head_parts import HIDDEN, Trunk

_KEEP = 0.99999


class ValueNorm(nn.Module):
    """Running mean and standard deviation of the targets so far, as in MAPPO; 0 and 1 before the first."""

    mean: Tensor
    square: Tensor
    weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name in ("mean", "square", "weight"):
            self.register_buffer(name, torch.zeros(()))

    def count(self, targets: Tensor) -> Tensor:
        """Count targets (B,) in and return them on the scale."""
        with torch.no_grad():
            self.mean.mul_(_KEEP).add_((1.0 - _KEEP) * targets.mean())
            self.square.mul_(_KEEP).add_((1.0 - _KEEP) * (targets * targets).mean())
            self.weight.mul_(_KEEP).add_(1.0 - _KEEP)
        mean, spread = self._moments()
        return (targets - mean) / spread

    def undo(self, scaled: Tensor) -> Tensor:
        """Return values in units of reward (B,)."""
        mean, spread = self._moments()
        return scaled * spread + mean

    def _moments(self) -> tuple[Tensor, Tensor]:
        if self.weight == 0.0:
            return self.mean, torch.ones_like(self.mean)
        mean = self.mean / self.weight
        return mean, (self.square / self.weight - mean * mean).clamp(min=1e-2).sqrt()


class ValueNetwork(nn.Module):
    """V of the joint observation, and of what runs on: with asynchronous options that is part of the state.

    Args:
        observation_size: Length D of the joint observation.
        counts: Number of options of each agent.

    Attributes:
        scale: Normalisation of its targets.
    """

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.trunk = Trunk(observation_size + sum(counts))
        self.head = nn.Linear(HIDDEN, 1)
        nn.init.orthogonal_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        self.scale = ValueNorm()

    def forward(self, observation: Tensor, running: Tensor) -> Tensor:
        """Return values on the learnt scale (B,) for observations (B, D) and running options (B, N)."""
        marks = [
            nn.functional.one_hot(running[:, agent].clamp(min=0), count) * (running[:, agent, None] != NONE)
            for agent, count in enumerate(self.counts)
        ]
        return self.head(self.trunk(torch.cat((observation, *marks), dim=1)))[:, 0]

    def values(self, observation: Tensor, running: Tensor) -> Tensor:
        """Return values in units of reward (B,)."""
        return self.scale.undo(self(observation, running))
