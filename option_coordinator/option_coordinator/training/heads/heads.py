"""The joint policies of `option_coordinator.policies.policy_file.HEADS` in torch, many decisions at once.

Their tensors carry the names that the NumPy policies know, so that both can share one memory: see `as_numpy`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from option_coordinator.options.decision import NONE
from option_coordinator.options.options import Agent
from option_coordinator.training.heads.autoregressive_head import AutoregressiveHead
from option_coordinator.training.heads.head_parts import DecisionBatch, Score
from option_coordinator.training.heads.mixture_head import MixtureHead
from option_coordinator.training.heads.table_head import TableHead


class PartialHeads(nn.ModuleList):
    """`option_coordinator.policies.partial.Partial`: one head for each agent, by its own observation (Eq. 5.5)."""

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
    """Return an untrained joint policy of the kind's name, whose observations may tell `presence` too.

    Its weights come from torch's generator.
    """
    counts = [len(agent.options) for agent in agents]
    sizes = [agent.observation_size for agent in agents]
    if partial:
        return PartialHeads([_HEADS[kind](size, counts) for size in sizes], sizes)
    return _HEADS[kind](sum(sizes) + presence * len(agents), counts)


def as_numpy(network: nn.Module) -> dict[str, NDArray[np.floating]]:
    """Return a network's tensors in NumPy, in the same memory: they go on changing as it learns."""
    return {name: tensor.detach().numpy() for name, tensor in network.state_dict().items()}
