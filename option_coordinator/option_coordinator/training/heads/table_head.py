"""The thesis's joint policy in torch, many decisions at once: see `option_coordinator.policies.joint_table`."""

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
)


class TableHead(nn.Module):
    """`option_coordinator.policies.joint_table.JointTable`."""

    cells: Tensor
    strides: Tensor

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.trunk = Trunk(observation_size)
        self.head = orthogonal(HIDDEN, math.prod(counts), HEAD_GAIN)
        self.register_buffer("cells", joint_options(counts), persistent=False)
        strides = [math.prod(self.counts[i + 1 :]) for i in range(len(counts))]
        self.register_buffer("strides", torch.tensor(strides), persistent=False)

    def logits(self, observation: Tensor) -> Tensor:
        """Return the table, flat (B, cells)."""
        return self.head(self.trunk(observation))

    def forward(self, decisions: DecisionBatch) -> Score:
        """Return log-probability and entropy."""
        table = self._without_absent(self.logits(decisions.observation), decisions)
        allowed = self.allowed(decisions)
        table = table.masked_fill(~allowed, NEVER)
        logs = torch.log_softmax(table, dim=-1)
        return Score(logs.gather(1, self.cell(decisions.options)[:, None])[:, 0], entropy_of(logs, allowed))

    def cell(self, options: Tensor) -> Tensor:
        """Return the index of joint options (B,); an absent agent counts as its option 0."""
        return (options.clamp(min=0) * self.strides).sum(dim=-1)

    def allowed(self, decisions: DecisionBatch) -> Tensor:
        """Return which cells agree with what runs and with what is legal (B, cells); the absent are at option 0."""
        return allowed_cells(self.cells, decisions, decisions.options.clamp(min=0))

    def _without_absent(self, table: Tensor, decisions: DecisionBatch) -> Tensor:
        """Sum the absent agents' options out: what remains stands at each of them."""
        absent = ~decisions.choosing & (decisions.options == NONE)
        if not absent.any():
            return table
        table = table.view(-1, *self.counts)
        for agent in range(len(self.counts)):
            row = absent[:, agent].reshape([-1] + [1] * len(self.counts))
            table = torch.where(row, table.logsumexp(dim=agent + 1, keepdim=True), table)
        return table.flatten(1)
