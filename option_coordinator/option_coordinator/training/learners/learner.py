"""Learners of joint options: their interface, the base class of minibatch learners, and imitation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from ctrl_rl_learning.torch import Arrays, gradient_step
from numpy.typing import NDArray
from torch import Tensor, nn

from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.options.options import Agent
from option_coordinator.policies.joint_policy import JointPolicy
from option_coordinator.policies.partial import with_presence
from option_coordinator.policies.policy_file import make_policy
from option_coordinator.training.heads.head_parts import DecisionBatch
from option_coordinator.training.heads.heads import as_numpy, make_head


class Learner(ABC):
    """Learns a joint policy from option-level trajectories.

    Attributes:
        network: Network of the joint policy.
        networks: All networks by name, for checkpoints.
        optimizers: All optimisers by name, for checkpoints.
        greedy: Whether to use the policy's most likely options rather than samples.
        settings: Settings of the algorithm, a dataclass.
    """

    network: nn.Module
    networks: Mapping[str, nn.Module]
    optimizers: Mapping[str, torch.optim.Optimizer]
    greedy: bool
    settings: Any

    @abstractmethod
    def behaviour(self, progress: float) -> JointPolicy:
        """Return the behaviour policy of the next trajectory, given the run's progress (0 to 1)."""

    @abstractmethod
    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from a trajectory and return metrics of the update."""

    def descend(self, loss: Tensor) -> None:
        """Take an optimiser step on a loss, clipping each network's gradient to `settings.gradient_norm`."""
        (optimizer,) = self.optimizers.values()
        clipped = [each for network in self.networks.values() if (each := list(network.parameters()))]
        gradient_step(optimizer, loss, *clipped, largest_norm=self.settings.gradient_norm)

    def memory(self) -> Arrays:
        """Return the remaining state as arrays, for checkpoints."""
        return {}

    def recall(self, arrays: Mapping[str, NDArray[Any]]) -> None:  # noqa: B027 - most have no further state
        """Restore the state returned by `memory`."""


def decision_batch(trajectory: OptionTrajectory, presence: bool = False) -> DecisionBatch:
    """Convert a trajectory's decisions to tensors; with `presence`, observations include the agents' presence."""
    seen = trajectory.observation
    return DecisionBatch(
        observation=as_tensor(with_presence(seen, trajectory.present) if presence else seen),
        options=torch.from_numpy(trajectory.options),
        choosing=torch.from_numpy(trajectory.choosing),
        legal=torch.from_numpy(trajectory.legal),
    )


def as_tensor(array: NDArray[np.floating]) -> Tensor:
    """Convert an array to a tensor of torch's default type."""
    return torch.from_numpy(array).to(torch.get_default_dtype())


Rows = Tensor | slice
"""Rows of a batch."""


class GradientLearner(Learner):
    """Base class of learners with one optimiser and one joint policy, whose samples provide the exploration.

    Args:
        agents: Agents whose options are learned.
        head: Kind of joint policy, a key of `HEADS`.
        partial: Whether each agent has its own policy (Eq. 5.5).
        settings: Settings of the algorithm; the default ones if omitted.
        presence: Whether the networks observe which agents are present.
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
        """Return the policy itself, which changes as it learns."""
        return self._policy

    def other_networks(self, agents: Sequence[Agent]) -> Mapping[str, nn.Module]:  # noqa: ARG002 - most have none
        """Return additional networks by name."""
        return {}

    def minibatches(self, steps: int, generator: np.random.Generator) -> Iterator[Rows]:
        """Yield random minibatches of about `minibatch` rows, `epochs` times over all steps."""
        count = round(steps / self.settings.minibatch)
        for _ in range(self.settings.epochs):
            if count <= 1:
                yield slice(None)
                continue
            for rows in np.array_split(generator.permutation(steps), count):
                yield torch.from_numpy(rows)


@dataclass(frozen=True)
class ImitationSettings:
    """Settings of behaviour cloning.

    Attributes:
        learning_rate: Learning rate of Adam.
        epochs: Number of passes over the data per call of `learn`.
        minibatch: Approximate number of option steps of a minibatch.
    """

    learning_rate: float = 5e-4
    epochs: int = 10
    minibatch: int = 256


class Imitation(GradientLearner):
    """Maximises log pi-hat(o_U | o_not-U, s) of the chosen options, regardless of reward."""

    SETTINGS = ImitationSettings

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from the chosen options.

        Returns:
            `loss`, `log_prob` of the options and `entropy`, means of the last minibatch [nat].
        """
        decisions = decision_batch(trajectory, self.presence)
        figures: dict[str, float] = {}
        (optimizer,) = self.optimizers.values()
        for rows in self.minibatches(len(trajectory), generator):
            score = self.network(decisions.at(rows))
            log_prob = score.log_prob.mean()
            gradient_step(optimizer, -log_prob)
            told = float(log_prob.detach())
            figures = {"loss": -told, "log_prob": told, "entropy": float(score.entropy.mean().detach())}
        return figures
