"""The joint policies of `option_coordinator.policies.policy_file.HEADS` in torch, for batches of decisions.

Their tensors have the same names as in the NumPy policies, so both can share memory, see `as_numpy`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from option_coordinator.options.options import NONE, Agent
from option_coordinator.policies.policy_file import check_size
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
"""Maximum number of joint options enumerated for the entropy; such a batch takes some 30 MB."""


class _Head(nn.Module):
    """A head on MAPPO's trunk, for agents with these numbers of options."""

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.trunk = Trunk(observation_size)


class TableHead(_Head):
    """Torch version of `option_coordinator.policies.network.JointTable`."""

    cells: Tensor
    strides: Tensor

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__(observation_size, counts)
        self.head = orthogonal(HIDDEN, math.prod(counts), HEAD_GAIN)
        self.register_buffer("cells", joint_options(counts), persistent=False)
        strides = [math.prod(self.counts[i + 1 :]) for i in range(len(counts))]
        self.register_buffer("strides", torch.tensor(strides), persistent=False)

    def logits(self, observation: Tensor) -> Tensor:
        """Return the table, flattened (B, cells)."""
        return self.head(self.trunk(observation))

    def forward(self, decisions: DecisionBatch) -> Score:
        """Return log-probability and entropy."""
        table = self._without_absent(self.logits(decisions.observation), decisions)
        allowed = self.allowed(decisions)
        table = table.masked_fill(~allowed, NEVER)
        logs = torch.log_softmax(table, dim=-1)
        return Score(logs.gather(1, self.cell(decisions.options)[:, None])[:, 0], entropy_of(logs, allowed))

    def cell(self, options: Tensor) -> Tensor:
        """Return the cell index of joint options (B,); absent agents count as option 0."""
        return (options.clamp(min=0) * self.strides).sum(dim=-1)

    def allowed(self, decisions: DecisionBatch) -> Tensor:
        """Return which cells agree with running and legal options (B, cells), with absent agents at option 0."""
        return allowed_cells(self.cells, decisions, decisions.options.clamp(min=0))

    def _without_absent(self, table: Tensor, decisions: DecisionBatch) -> Tensor:
        """Marginalise out the absent agents' options; each of their options then has the sum."""
        absent = ~decisions.choosing & (decisions.options == NONE)
        if not absent.any():
            return table
        table = table.view(-1, *self.counts)
        for agent in range(len(self.counts)):
            row = absent[:, agent].reshape([-1] + [1] * len(self.counts))
            table = torch.where(row, table.logsumexp(dim=agent + 1, keepdim=True), table)
        return table.flatten(1)


class MixtureHead(_Head):
    """Torch version of `option_coordinator.policies.network.Mixture`."""

    cells: Tensor | None
    option_mask: Tensor

    def __init__(self, observation_size: int, counts: Sequence[int], rank: int = RANK) -> None:
        super().__init__(observation_size, counts)
        self.rank = rank
        self.weights = orthogonal(HIDDEN, rank, HEAD_GAIN)
        self.head = orthogonal(HIDDEN, rank * sum(counts), 1.0)  # identical components would never separate
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
        """Return the log weights (B, R) and log factors (B, R, N, K), given running and legal options."""
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
        """Return the sum of each choosing agent's entropy, given the agents before it (B,)."""
        before = weights[..., None] + taken.cumsum(dim=-1) - taken
        links = (torch.log_softmax(before, dim=1)[..., None] + factors).logsumexp(dim=1)
        return (entropy_of(links, decisions.legal) * decisions.choosing).sum(dim=-1)


class AutoregressiveHead(_Head):
    """Torch version of `option_coordinator.policies.network.Autoregressive`."""

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__(observation_size, counts)
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
        """Return the contribution of a known option to the hidden layer (B, H); zero for absent agents."""
        begin = sum(self.counts[:agent])
        return self.known.weight.T[begin + options.clamp(min=0)] * (options != NONE)[:, None]


class PartialHeads(nn.ModuleList):
    """Torch version of `option_coordinator.policies.partial.Partial`: one head per agent, with its own observation."""

    def __init__(self, heads: Sequence[nn.Module], observation_sizes: Sequence[int]) -> None:
        super().__init__(heads)
        self.observation_sizes = tuple(observation_sizes)

    def forward(self, decisions: DecisionBatch) -> Score:
        """Return log-probability and entropy."""
        observations = torch.split(decisions.observation, list(self.observation_sizes), dim=1)
        log_prob = entropy = decisions.observation.new_zeros(len(decisions.observation))
        for agent, (head, own) in enumerate(zip(self, observations, strict=True)):
            alone = torch.zeros_like(decisions.choosing)
            alone[:, agent] = decisions.choosing[:, agent]
            unknown = decisions.choosing & ~alone
            score = head(DecisionBatch(own, decisions.options.masked_fill(unknown, NONE), alone, decisions.legal))
            chooses = decisions.choosing[:, agent]
            log_prob = log_prob + score.log_prob * chooses
            entropy = entropy + score.entropy * chooses
        return Score(log_prob, entropy)


_HEADS: Mapping[str, type[TableHead | MixtureHead | AutoregressiveHead]] = {
    "table": TableHead,
    "mixture": MixtureHead,
    "autoregressive": AutoregressiveHead,
}


def make_head(kind: str, agents: Sequence[Agent], partial: bool = False, presence: bool = False) -> nn.Module:
    """Create an untrained joint policy of a kind, optionally with `presence` in its observations.

    The weights are drawn from torch's global generator.

    Raises:
        OptionError: The kind is too large for these agents, see `check_size`.
    """
    counts = [len(agent.options) for agent in agents]
    check_size(kind, counts)
    sizes = [agent.observation_size for agent in agents]
    if partial:
        return PartialHeads([_HEADS[kind](size, counts) for size in sizes], sizes)
    return _HEADS[kind](sum(sizes) + presence * len(agents), counts)


def as_numpy(network: nn.Module) -> dict[str, NDArray[np.floating]]:
    """Return a network's tensors as NumPy arrays that share memory and so change during learning."""
    return {name: tensor.detach().numpy() for name, tensor in network.state_dict().items()}
