"""The any-order autoregressive policy of `option_coordinator.policies.autoregressive` in torch, batched."""

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
    entropy_of,
    orthogonal,
)


class AutoregressiveHead(nn.Module):
    """`option_coordinator.policies.autoregressive.Autoregressive`."""

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.trunk = Trunk(observation_size)
        self.state = orthogonal(HIDDEN, HIDDEN, math.sqrt(2.0))
        self.known = nn.Linear(sum(counts), HIDDEN, bias=False)
        nn.init.orthogonal_(self.known.weight)
        self.norm = nn.LayerNorm(HIDDEN)
        self.head = orthogonal(HIDDEN, sum(counts), HEAD_GAIN)

    def forward(self, decisions: DecisionBatch) -> Score:
        """Return log-probability and entropy."""
        hidden = self.state(self.trunk(decisions.observation))
        shares = [self._share(decisions.options[:, agent], agent) for agent in range(len(self.counts))]
        for agent, share in enumerate(shares):
            hidden = hidden + share * ~decisions.choosing[:, agent, None]
        log_prob = entropy = hidden.new_zeros(len(hidden))
        begin = 0
        for agent, count in enumerate(self.counts):
            logits = self.head(self.norm(torch.relu(hidden)))[:, begin : begin + count]
            legal = decisions.legal[:, agent, :count]
            logs = torch.log_softmax(logits.masked_fill(~legal, NEVER), dim=-1)
            chooses = decisions.choosing[:, agent]
            taken = logs.gather(1, decisions.options[:, agent, None].clamp(min=0))[:, 0]
            log_prob = log_prob + taken * chooses
            entropy = entropy + entropy_of(logs, legal) * chooses
            hidden = hidden + shares[agent] * chooses[:, None]
            begin += count
        return Score(log_prob, entropy)

    def _share(self, options: Tensor, agent: int) -> Tensor:
        """Return what knowing an agent's options adds to the hidden layer (B, H); nothing for the absent."""
        begin = sum(self.counts[:agent])
        return self.known.weight.T[begin + options.clamp(min=0)] * (options != NONE)[:, None]
