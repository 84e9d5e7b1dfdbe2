"""Parts of the joint policies in torch: inputs, outputs, the trunk, and sums over joint options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor, nn

from option_coordinator.options.options import NONE

HIDDEN = 64
HEAD_GAIN = 0.01
NEVER = -1e9
"""Log-probability of impossible options: its exp is 0 but, unlike -inf, it has a gradient."""


class DecisionBatch(NamedTuple):
    """A batch of B decisions as tensors.

    Attributes:
        observation: Joint observations (B, D).
        options: Chosen or continuing options; `NONE` for absent agents (B, N).
        choosing: Whether each agent chose (B, N).
        legal: Whether each option was legal (B, N, K).
    """

    observation: Tensor
    options: Tensor
    choosing: Tensor
    legal: Tensor

    def at(self, rows: Tensor | slice) -> DecisionBatch:
        """Select rows."""
        return DecisionBatch(*(part[rows] for part in self))


class Score(NamedTuple):
    """log pi-hat(o_U | o_not-U, s) and the entropy of pi-hat, both (B,).

    The entropy is exact if joint options can be enumerated. Otherwise, and for a chain, it is the sum over the
    conditionals along the chosen options, an unbiased estimate.
    """

    log_prob: Tensor
    entropy: Tensor


class Trunk(nn.Module):
    """MAPPO's trunk: norm, then twice linear, ReLU, norm."""

    def __init__(self, inputs: int, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.norm_0 = nn.LayerNorm(inputs)
        self.linear_1 = orthogonal(inputs, hidden, math.sqrt(2.0))
        self.norm_1 = nn.LayerNorm(hidden)
        self.linear_2 = orthogonal(hidden, hidden, math.sqrt(2.0))
        self.norm_2 = nn.LayerNorm(hidden)

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, hidden)."""
        x = self.norm_1(torch.relu(self.linear_1(self.norm_0(x))))
        return self.norm_2(torch.relu(self.linear_2(x)))


def orthogonal(inputs: int, outputs: int, gain: float) -> nn.Linear:
    """Create a linear layer with orthogonal weights and zero bias."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def joint_options(counts: Sequence[int]) -> Tensor:
    """Return every joint option (cells, N)."""
    return torch.tensor(list(product(*(range(count) for count in counts))))


def allowed_cells(cells: Tensor, decisions: DecisionBatch, fixed: Tensor) -> Tensor:
    """Return the cells (B, cells) with legal options of choosing agents and `fixed` (B, N) options of the others."""
    agents = torch.arange(cells.shape[1])
    legal = decisions.legal[:, agents, cells]
    same = cells[None] == fixed[:, None]
    return torch.where(decisions.choosing[:, None], legal, same).all(dim=-1)


def taken_at(logs: Tensor, options: Tensor) -> Tensor:
    """Select the entries (..., N) of logs (..., N, K) at options (..., N); `NONE` selects option 0."""
    index = options.clamp(min=0).expand(logs.shape[:-1])
    return logs.gather(-1, index[..., None])[..., 0]


def entropy_of(logs: Tensor, allowed: Tensor) -> Tensor:
    """Return -sum p log p (...,) over the allowed entries."""
    logs = logs.masked_fill(~allowed, 0.0)
    return -(logs.exp() * logs * allowed).sum(dim=-1)


_KEEP = 0.99999


class ValueNorm(nn.Module):
    """Running mean and standard deviation of the targets, as in MAPPO; initially 0 and 1."""

    mean: Tensor
    square: Tensor
    weight: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name in ("mean", "square", "weight"):
            self.register_buffer(name, torch.zeros(()))

    def count(self, targets: Tensor) -> Tensor:
        """Update the statistics with targets (B,), and return the normalised targets."""
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
    """Value function of the joint observation and the running options, part of the state with asynchronous options.

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
        """Return normalised values (B,) for observations (B, D) and running options (B, N)."""
        marks = [
            nn.functional.one_hot(running[:, agent].clamp(min=0), count) * (running[:, agent, None] != NONE)
            for agent, count in enumerate(self.counts)
        ]
        return self.head(self.trunk(torch.cat((observation, *marks), dim=1)))[:, 0]

    def values(self, observation: Tensor, running: Tensor) -> Tensor:
        """Return values in units of reward (B,)."""
        return self.scale.undo(self(observation, running))
