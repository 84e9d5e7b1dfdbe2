"""The centralised value network V(s_kappa)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from option_coordinator.options.decision import NONE
from option_coordinator.training.heads.head_parts import HIDDEN, Trunk
from option_coordinator.training.heads.value_norm import ValueNorm


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
