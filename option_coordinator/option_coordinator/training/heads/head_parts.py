"""Parts of the joint policies in torch: inputs, outputs, the trunk, and sums over joint options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor, nn

HIDDEN = 64
HEAD_GAIN = 0.01
NEVER = -1e9
"""Log-probability of what cannot be: exp of it is 0, and unlike -inf it has a gradient."""


class DecisionBatch(NamedTuple):
    """A batch of B decisions as tensors.

    Attributes:
        observation: Joint observations (B, D).
        options: Options that were chosen or ran on, `NONE` for absent agents (B, N).
        choosing: Whether each agent chose (B, N).
        legal: Whether each option was legal (B, N, K).
    """

    observation: Tensor
    options: Tensor
    choosing: Tensor
    legal: Tensor

    def at(self, rows: Tensor | slice) -> DecisionBatch:
        """Return some of them."""
        return DecisionBatch(*(part[rows] for part in self))


class Score(NamedTuple):
    """log pi-hat(o_U | o_not-U, s) and the entropy of pi-hat, both (B,).

    The entropy is exact where joint options can be counted; else, and for a chain, that of the links met along the
    options taken: its mean over draws is the entropy.
    """

    log_prob: Tensor
    entropy: Tensor


class Trunk(nn.Module):
    """MAPPO's body: norm, then twice linear, ReLU, norm."""

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
    """Return a linear layer with orthogonal weights and no bias yet."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def joint_options(counts: Sequence[int]) -> Tensor:
    """Return every joint option (cells, N)."""
    return torch.tensor(list(product(*(range(count) for count in counts))))


def allowed_cells(cells: Tensor, decisions: DecisionBatch, fixed: Tensor) -> Tensor:
    """Return which cells hold legal options of who chooses, and `fixed` (B, N) of everybody else (B, cells)."""
    agents = torch.arange(cells.shape[1])
    legal = decisions.legal[:, agents, cells]
    same = cells[None] == fixed[:, None]
    return torch.where(decisions.choosing[:, None], legal, same).all(dim=-1)


def taken_at(logs: Tensor, options: Tensor) -> Tensor:
    """Return the entries (..., N) of logs (..., N, K) at options (..., N), 0 for `NONE` being as good as any."""
    index = options.clamp(min=0).expand(logs.shape[:-1])
    return logs.gather(-1, index[..., None])[..., 0]


def entropy_of(logs: Tensor, allowed: Tensor) -> Tensor:
    """Return -sum p log p (...,) over what is allowed."""
    logs = logs.masked_fill(~allowed, 0.0)
    return -(logs.exp() * logs * allowed).sum(dim=-1)
