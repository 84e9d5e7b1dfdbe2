"""The base of learners that go over a trajectory several times in minibatches: MAPPO, imitation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from option_coordinator.options.options import Agent
from option_coordinator.policies.joint_policy import JointPolicy
from option_coordinator.policies.policy_file import make_policy
from option_coordinator.training.heads.heads import as_numpy, make_head
from option_coordinator.training.learners.learner import Learner

Rows = Tensor | slice
"""Rows of a batch."""


class GradientLearner(Learner):
    """Has a joint policy, which explores by its own draws, and one optimiser; `settings` name epochs and minibatch.

    Args:
        agents: Agents whose options are learned.
        head: Kind of joint policy, a key of `HEADS`.
        partial: Whether each agent has a policy of its own (Eq. 5.5).
        settings: Settings of the algorithm; the defaults unless given.
        presence: Whether its networks are told which agents are present.
    """

    SETTINGS: ClassVar[type[Any]]
    ADAM_EPSILON = 1e-8
    greedy = False

    def __init__(
        self, agents: Sequence[Agent], head: str, partial: bool = False, settings: Any = None, presence: bool = False
    ) -> None:
        counts = tuple(len(agent.options) for agent in agents)
        self.settings = settings or self.SETTINGS()
        self.presence = presence
        self.network = make_head(head, agents, partial, presence)
        self.networks = {"policy": self.network, **self.other_networks(agents)}
        parameters = [parameter for network in self.networks.values() for parameter in network.parameters()]
        adam = torch.optim.Adam(parameters, self.settings.learning_rate, eps=self.ADAM_EPSILON, fused=True)
        self.optimizers = {"optimizer": adam}
        self._policy = make_policy(head, as_numpy(self.network), counts, partial, presence)

    def behaviour(self, progress: float) -> JointPolicy:  # noqa: ARG002 - it explores by its own draws
        """Return the policy, which goes on changing as it learns."""
        return self._policy

    def other_networks(self, agents: Sequence[Agent]) -> Mapping[str, nn.Module]:  # noqa: ARG002 - most have none
        """Return the networks by name that it learns besides the policy's."""
        return {}

    def minibatches(self, steps: int, generator: np.random.Generator) -> Iterator[Rows]:
        """Yield the rows of a batch of so many steps `epochs` times, in random parts of about `minibatch`, or all."""
        count = round(steps / self.settings.minibatch)
        for _ in range(self.settings.epochs):
            if count <= 1:
                yield slice(None)
                continue
            for rows in np.array_split(generator.permutation(steps), count):
                yield torch.from_numpy(rows)
