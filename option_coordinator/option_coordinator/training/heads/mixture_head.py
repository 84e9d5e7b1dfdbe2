"""A mixture of products in torch, many decisions at once: see `option_coordinator.policies.mixture`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from option_coordinator.options.decision import NONE
from option_coordinator.training.heads.head_parts import (
    HEAD_GAIN,
    HIDDEN,
    NEVER,
    DecisionBatch,
    Score,
    Trunk,
    allowed_cells,
    entropy_of,
    joint_options,
    orthogonal,
    taken_at,
)

RANK = 8
COUNTABLE = 256
"""Joint options up to which the entropy is summed over all of them: a batch of so many takes some 30 MB."""


class MixtureHead(nn.Module):
    """`option_coordinator.policies.mixture.Mixture`."""

    cells: Tensor | None
    option_mask: Tensor

    def __init__(self, observation_size: int, counts: Sequence[int], rank: int = RANK) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.rank = rank
        self.trunk = Trunk(observation_size)
        self.weights = orthogonal(HIDDEN, rank, HEAD_GAIN)
        self.head = orthogonal(HIDDEN, rank * sum(counts), 1.0)  # components that are alike would never part
        option_mask = torch.arange(max(counts)) < torch.tensor(self.counts)[:, None]
        self.register_buffer("option_mask", option_mask, persistent=False)
        countable = math.prod(counts) <= COUNTABLE
        self.register_buffer("cells", joint_options(counts) if countable else None, persistent=False)

    def forward(self, decisions: DecisionBatch) -> Score:
        """Return log-probability and entropy."""
        weights, factors = self._given(decisions)
        taken = taken_at(factors, decisions.options[:, None]) * decisions.choosing[:, None]
        log_prob = (weights + taken.sum(dim=-1)).logsumexp(dim=-1)
        if self.cells is None:
            return Score(log_prob, self._chain(weights, factors, taken, decisions))
        allowed = allowed_cells(self.cells, decisions, torch.zeros_like(decisions.options))
        agents = torch.arange(len(self.counts))
        of_cells = factors[:, :, agents, self.cells] * decisions.choosing[:, None, None]
        logs = (weights[..., None] + of_cells.sum(dim=-1)).logsumexp(dim=1)
        return Score(log_prob, entropy_of(logs, allowed))

    def _given(self, decisions: DecisionBatch) -> tuple[Tensor, Tensor]:
        """Return the weights (B, R) and factors (B, R, N, K), given what runs and what is legal; as logarithms."""
        x = self.trunk(decisions.observation)
        logits = x.new_full((len(x), self.rank, *self.option_mask.shape), NEVER)
        logits[:, :, self.option_mask] = self.head(x).view(len(x), self.rank, -1)
        logs = torch.log_softmax(logits, dim=-1)
        runs = ~decisions.choosing & (decisions.options != NONE)
        legal = logs.masked_fill(~decisions.legal[:, None], NEVER)
        share = legal.logsumexp(dim=-1)
        evidence = taken_at(logs, decisions.options[:, None]) * runs[:, None] + share * decisions.choosing[:, None]
        weights = torch.log_softmax(self.weights(x), dim=-1) + evidence.sum(dim=-1)
        return torch.log_softmax(weights, dim=-1), legal - share[..., None]

    def _chain(self, weights: Tensor, factors: Tensor, taken: Tensor, decisions: DecisionBatch) -> Tensor:
        """Return the entropies of each chooser given those before it, summed (B,)."""
        before = weights[..., None] + taken.cumsum(dim=-1) - taken
        links = (torch.log_softmax(before, dim=1)[..., None] + factors).logsumexp(dim=1)
        return (entropy_of(links, decisions.legal) * decisions.choosing).sum(dim=-1)
