"""The joint policies of `option_coordinator.policy_file.HEADS` in torch, many decisions at once.

Their tensors carry the names that the NumPy policies know, so that both can share one memory: see `as_numpy`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from option_coordinator.decision import NONE
from option_coordinator.joint_policy import ENUMERABLE
from option_coordinator.options import Agent

HIDDEN = 64
RANK = 8
HEAD_GAIN = 0.01
_NEVER = -1e9
"""Log-probability of what cannot be: exp of it is 0, and unlike -inf it has a gradient."""


class Choice(NamedTuple):
    """Decisions, as tensors.

    Attributes:
        observation: (B, D).
        options: what was chosen or ran on, `NONE` for the absent (B, N).
        choosing: (B, N).
        legal: (B, N, K).
    """

    observation: Tensor
    options: Tensor
    choosing: Tensor
    legal: Tensor


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
        self.linear_1 = _linear(inputs, hidden, math.sqrt(2.0))
        self.norm_1 = nn.LayerNorm(hidden)
        self.linear_2 = _linear(hidden, hidden, math.sqrt(2.0))
        self.norm_2 = nn.LayerNorm(hidden)

    def forward(self, x: Tensor) -> Tensor:
        """Return features (B, hidden)."""
        x = self.norm_1(torch.relu(self.linear_1(self.norm_0(x))))
        return self.norm_2(torch.relu(self.linear_2(x)))


class TableHead(nn.Module):
    """`option_coordinator.joint_table.JointTable`."""

    cells: Tensor
    strides: Tensor

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.trunk = Trunk(observation_size)
        self.head = _linear(HIDDEN, math.prod(counts), HEAD_GAIN)
        self.register_buffer("cells", _cells(counts), persistent=False)
        strides = [math.prod(self.counts[i + 1 :]) for i in range(len(counts))]
        self.register_buffer("strides", torch.tensor(strides), persistent=False)

    def logits(self, observation: Tensor) -> Tensor:
        """Return the table, flat (B, cells)."""
        return self.head(self.trunk(observation))

    def forward(self, choice: Choice) -> Score:
        """Return log-probability and entropy."""
        table = self._without_absent(self.logits(choice.observation), choice)
        allowed = self.allowed(choice)
        table = table.masked_fill(~allowed, _NEVER)
        logs = torch.log_softmax(table, dim=-1)
        return Score(logs.gather(1, self.cell(choice.options)[:, None])[:, 0], _entropy(logs, allowed))

    def cell(self, options: Tensor) -> Tensor:
        """Return the index of joint options (B,); an absent agent counts as its option 0."""
        return (options.clamp(min=0) * self.strides).sum(dim=-1)

    def allowed(self, choice: Choice) -> Tensor:
        """Return which cells agree with what runs and with what is legal (B, cells); the absent are at option 0."""
        return _allowed(self.cells, choice, choice.options.clamp(min=0))

    def _without_absent(self, table: Tensor, choice: Choice) -> Tensor:
        """Sum the absent agents' options out: what remains stands at each of them."""
        absent = ~choice.choosing & (choice.options == NONE)
        if not absent.any():
            return table
        table = table.view(-1, *self.counts)
        for agent in range(len(self.counts)):
            row = absent[:, agent].reshape([-1] + [1] * len(self.counts))
            table = torch.where(row, table.logsumexp(dim=agent + 1, keepdim=True), table)
        return table.flatten(1)


class MixtureHead(nn.Module):
    """`option_coordinator.mixture.Mixture`."""

    cells: Tensor | None
    slots: Tensor

    def __init__(self, observation_size: int, counts: Sequence[int], rank: int = RANK) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.rank = rank
        self.trunk = Trunk(observation_size)
        self.weights = _linear(HIDDEN, rank, HEAD_GAIN)
        self.head = _linear(HIDDEN, rank * sum(counts), 1.0)  # components that are alike would never part
        slots = torch.arange(max(counts)) < torch.tensor(self.counts)[:, None]
        self.register_buffer("slots", slots, persistent=False)
        countable = math.prod(counts) <= ENUMERABLE
        self.register_buffer("cells", _cells(counts) if countable else None, persistent=False)

    def forward(self, choice: Choice) -> Score:
        """Return log-probability and entropy."""
        weights, factors = self._given(choice)
        taken = _at(factors, choice.options[:, None]) * choice.choosing[:, None]
        log_prob = (weights + taken.sum(dim=-1)).logsumexp(dim=-1)
        if self.cells is None:
            return Score(log_prob, self._chain(weights, factors, taken, choice))
        allowed = _allowed(self.cells, choice, torch.zeros_like(choice.options))
        agents = torch.arange(len(self.counts))
        of_cells = factors[:, :, agents, self.cells] * choice.choosing[:, None, None]
        logs = (weights[..., None] + of_cells.sum(dim=-1)).logsumexp(dim=1)
        return Score(log_prob, _entropy(logs, allowed))

    def _given(self, choice: Choice) -> tuple[Tensor, Tensor]:
        """Return the weights (B, R) and factors (B, R, N, K), given what runs and what is legal; as logarithms."""
        x = self.trunk(choice.observation)
        logits = x.new_full((len(x), self.rank, *self.slots.shape), _NEVER)
        logits[:, :, self.slots] = self.head(x).view(len(x), self.rank, -1)
        logs = torch.log_softmax(logits, dim=-1)
        runs = ~choice.choosing & (choice.options != NONE)
        legal = logs.masked_fill(~choice.legal[:, None], _NEVER)
        share = legal.logsumexp(dim=-1)
        evidence = _at(logs, choice.options[:, None]) * runs[:, None] + share * choice.choosing[:, None]
        weights = torch.log_softmax(self.weights(x), dim=-1) + evidence.sum(dim=-1)
        return torch.log_softmax(weights, dim=-1), legal - share[..., None]

    def _chain(self, weights: Tensor, factors: Tensor, taken: Tensor, choice: Choice) -> Tensor:
        """Return the entropies of each chooser given those before it, summed (B,)."""
        before = weights[..., None] + taken.cumsum(dim=-1) - taken
        links = (torch.log_softmax(before, dim=1)[..., None] + factors).logsumexp(dim=1)
        return (_entropy(links, choice.legal) * choice.choosing).sum(dim=-1)


class AutoregressiveHead(nn.Module):
    """`option_coordinator.autoregressive.Autoregressive`."""

    def __init__(self, observation_size: int, counts: Sequence[int]) -> None:
        super().__init__()
        self.counts = tuple(counts)
        self.trunk = Trunk(observation_size)
        self.state = _linear(HIDDEN, HIDDEN, math.sqrt(2.0))
        self.known = nn.Linear(sum(counts), HIDDEN, bias=False)
        nn.init.orthogonal_(self.known.weight)
        self.norm = nn.LayerNorm(HIDDEN)
        self.head = _linear(HIDDEN, sum(counts), HEAD_GAIN)

    def forward(self, choice: Choice) -> Score:
        """Return log-probability and entropy."""
        hidden = self.state(self.trunk(choice.observation))
        shares = [self._share(choice.options[:, agent], agent) for agent in range(len(self.counts))]
        for agent, share in enumerate(shares):
            hidden = hidden + share * ~choice.choosing[:, agent, None]
        log_prob = entropy = hidden.new_zeros(len(hidden))
        begin = 0
        for agent, count in enumerate(self.counts):
            logits = self.head(self.norm(torch.relu(hidden)))[:, begin : begin + count]
            legal = choice.legal[:, agent, :count]
            logs = torch.log_softmax(logits.masked_fill(~legal, _NEVER), dim=-1)
            chooses = choice.choosing[:, agent]
            taken = logs.gather(1, choice.options[:, agent, None].clamp(min=0))[:, 0]
            log_prob = log_prob + taken * chooses
            entropy = entropy + _entropy(logs, legal) * chooses
            hidden = hidden + shares[agent] * chooses[:, None]
            begin += count
        return Score(log_prob, entropy)

    def _share(self, options: Tensor, agent: int) -> Tensor:
        """Return what knowing an agent's options adds to the hidden layer (B, H); nothing for the absent."""
        begin = sum(self.counts[:agent])
        return self.known.weight.T[begin + options.clamp(min=0)] * (options != NONE)[:, None]


class PartialHeads(nn.ModuleList):
    """`option_coordinator.partial.Partial`: one head for each agent, by its own observation (Eq. 5.5)."""

    def __init__(self, heads: Sequence[nn.Module], observation_sizes: Sequence[int]) -> None:
        super().__init__(heads)
        self.observation_sizes = tuple(observation_sizes)

    def forward(self, choice: Choice) -> Score:
        """Return log-probability and entropy."""
        observations = torch.split(choice.observation, list(self.observation_sizes), dim=1)
        log_prob = entropy = choice.observation.new_zeros(len(choice.observation))
        for agent, (head, own) in enumerate(zip(self, observations, strict=True)):
            alone = torch.zeros_like(choice.choosing)
            alone[:, agent] = choice.choosing[:, agent]
            unknown = choice.choosing & ~alone
            score = head(Choice(own, choice.options.masked_fill(unknown, NONE), alone, choice.legal))
            chooses = choice.choosing[:, agent]
            log_prob = log_prob + score.log_prob * chooses
            entropy = entropy + score.entropy * chooses
        return Score(log_prob, entropy)


_HEADS: Mapping[str, type[TableHead | MixtureHead | AutoregressiveHead]] = {
    "table": TableHead,
    "mixture": MixtureHead,
    "autoregressive": AutoregressiveHead,
}


def make_head(kind: str, agents: Sequence[Agent], partial: bool = False) -> nn.Module:
    """Return an untrained joint policy of the kind's name; its weights come from torch's generator."""
    counts = [len(agent.options) for agent in agents]
    sizes = [agent.observation_size for agent in agents]
    if partial:
        return PartialHeads([_HEADS[kind](size, counts) for size in sizes], sizes)
    return _HEADS[kind](sum(sizes), counts)


def as_numpy(network: nn.Module) -> dict[str, NDArray[np.floating]]:
    """Return a network's tensors in NumPy, in the same memory: they go on changing as it learns."""
    return {name: tensor.detach().numpy() for name, tensor in network.state_dict().items()}


def _linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def _cells(counts: Sequence[int]) -> Tensor:
    """Return every joint option (cells, N)."""
    return torch.tensor(list(product(*(range(count) for count in counts))))


def _allowed(cells: Tensor, choice: Choice, fixed: Tensor) -> Tensor:
    """Return which cells hold legal options of who chooses, and `fixed` (B, N) of everybody else (B, cells)."""
    agents = torch.arange(cells.shape[1])
    legal = choice.legal[:, agents, cells]
    same = cells[None] == fixed[:, None]
    return torch.where(choice.choosing[:, None], legal, same).all(dim=-1)


def _at(logs: Tensor, options: Tensor) -> Tensor:
    """Return the entries (..., N) of logs (..., N, K) at options (..., N), 0 for `NONE` being as good as any."""
    index = options.clamp(min=0).expand(logs.shape[:-1])
    return logs.gather(-1, index[..., None])[..., 0]


def _entropy(logs: Tensor, allowed: Tensor) -> Tensor:
    """Return -sum p log p (...,) over what is allowed."""
    logs = logs.masked_fill(~allowed, 0.0)
    return -(logs.exp() * logs * allowed).sum(dim=-1)
