"""The base of learners that go over a trajectory several times in minibatches: MAPPO, imitation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol, Self, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from option_coordinator.options.options import Agent
from option_coordinator.policies.joint_policy import JointPolicy
from option_coordinator.policies.policy_file import make_policy
from option_coordinator.training.heads.heads import as_numpy, make_head
from option_coordinator.training.learners.learner import Learner


class Batch(Protocol):
    """A batch of option steps."""

    def at(self, rows: Tensor) -> Self:
        """Return the given rows."""


_Batch = TypeVar("_Batch", bound=Batch)


class GradientLearner(Learner):
    """Has a joint policy, which explores by its own draws, and one optimiser; `settings` name epochs and minibatch.

    Args:
        agents: Agents whose options are learned.
        head: Kind of joint policy, a key of `HEADS`.
        partial: Whether each agent has a policy of its own.
        presence: Whether the policy is told which agents are present.
    """

    greedy = False
    optimizer: torch.optim.Optimizer

    def __init__(self, agents: Sequence[Agent], head: str, partial: bool, presence: bool) -> None:
        counts = tuple(len(agent.options) for agent in agents)
        self.network = make_head(head, agents, partial, presence)
        self.presence = presence
        self._policy = make_policy(head, as_numpy(self.network), counts, partial, presence)

    def behaviour(self, progress: float) -> JointPolicy:  # noqa: ARG002 - it explores by its own draws
        """Return the policy, which goes on changing as it learns."""
        return self._policy

    def networks(self) -> Mapping[str, nn.Module]:
        """Return all networks by name."""
        return {"policy": self.network}

    def optimizers(self) -> Mapping[str, torch.optim.Optimizer]:
        """Return all optimisers by name."""
        return {"optimizer": self.optimizer}

    def minibatches(self, batch: _Batch, steps: int, generator: np.random.Generator) -> Iterator[_Batch]:
        """Yield a batch of so many steps `epochs` times, in parts of about `minibatch` at random, or whole."""
        count = round(steps / self.settings.minibatch)
        for _ in range(self.settings.epochs):
            if count <= 1:
                yield batch
                continue
            for rows in np.array_split(generator.permutation(steps), count):
                yield batch.at(torch.from_numpy(rows))
