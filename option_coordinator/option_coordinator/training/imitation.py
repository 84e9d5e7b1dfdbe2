"""Learning to choose as was chosen, by whatever it was: behaviour cloning of recorded options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from option_coordinator.joint_policy import JointPolicy
from option_coordinator.options import Agent
from option_coordinator.policy_file import make_policy
from option_coordinator.training.head_parts import Choice
from option_coordinator.training.heads import as_numpy, make_head
from option_coordinator.training.learner import Learner, as_choice, minibatches
from option_coordinator.trajectory import Trajectory


@dataclass(frozen=True)
class ImitationSettings:
    """How it is learnt.

    Attributes:
        learning_rate: of Adam.
        epochs: of a call of `learn`.
        minibatch: option steps that are learnt from at once, about.
    """

    learning_rate: float = 5e-4
    epochs: int = 10
    minibatch: int = 256


class Imitation(Learner):
    """Raises log pi-hat(o_U | o_not-U, s) of what was chosen, whatever it brought.

    Args:
        agents: whose options are learnt.
        head: kind of joint policy.
        partial: whether each agent has one of its own.
        settings: of the algorithm.
        presence: whether the policy is told who is there.
    """

    greedy = False

    def __init__(
        self,
        agents: Sequence[Agent],
        head: str,
        partial: bool = False,
        settings: ImitationSettings | None = None,
        presence: bool = False,
    ) -> None:
        self.settings = settings or ImitationSettings()
        self.network = make_head(head, agents, partial, presence)
        self._presence = presence
        self._optimizer = torch.optim.Adam(self.network.parameters(), self.settings.learning_rate, fused=True)
        counts = tuple(len(agent.options) for agent in agents)
        self._policy = make_policy(head, as_numpy(self.network), counts, partial, presence)

    def behaviour(self, progress: float) -> JointPolicy:  # noqa: ARG002 - it gathers nothing
        """Return the policy, which goes on changing as it learns."""
        return self._policy

    def networks(self) -> Mapping[str, nn.Module]:
        """Return all networks by name."""
        return {"policy": self.network}

    def optimizers(self) -> Mapping[str, torch.optim.Optimizer]:
        """Return all optimisers by name."""
        return {"optimizer": self._optimizer}

    def learn(self, trajectory: Trajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from what was chosen.

        Returns:
            `log_prob` of it and `entropy`, means of the last minibatch [nat].
        """
        choice = as_choice(trajectory, self._presence)
        figures: dict[str, float] = {}
        for _ in range(self.settings.epochs):
            for rows in minibatches(len(trajectory), self.settings.minibatch, generator):
                score = self.network(choice if rows is None else Choice(*(part[rows] for part in choice)))
                log_prob = score.log_prob.mean()
                self._optimizer.zero_grad()
                (-log_prob).backward()
                self._optimizer.step()
                figures = {"log_prob": float(log_prob.detach()), "entropy": float(score.entropy.mean().detach())}
        return figures
