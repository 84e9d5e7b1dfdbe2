"""Behaviour cloning of recorded options, whatever chose them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.options.options import Agent
from option_coordinator.training.learners.gradient_learner import GradientLearner
from option_coordinator.training.learners.learner import decision_batch


@dataclass(frozen=True)
class ImitationSettings:
    """Settings of behaviour cloning.

    Attributes:
        learning_rate: Learning rate of Adam.
        epochs: Number of passes over the data in a call of `learn`.
        minibatch: Approximate number of option steps of a minibatch.
    """

    learning_rate: float = 5e-4
    epochs: int = 10
    minibatch: int = 256


class Imitation(GradientLearner):
    """Raises log pi-hat(o_U | o_not-U, s) of what was chosen, whatever it brought.

    Args:
        agents: Agents whose options are learned.
        head: Kind of joint policy, a key of `HEADS`.
        partial: Whether each agent has a policy of its own.
        settings: Settings of the algorithm; the defaults unless given.
        presence: Whether the policy is told which agents are present.
    """

    def __init__(
        self,
        agents: Sequence[Agent],
        head: str,
        partial: bool = False,
        settings: ImitationSettings | None = None,
        presence: bool = False,
    ) -> None:
        super().__init__(agents, head, partial, presence)
        self.settings = settings or ImitationSettings()
        self.optimizer = torch.optim.Adam(self.network.parameters(), self.settings.learning_rate, fused=True)

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from what was chosen.

        Returns:
            `log_prob` of it and `entropy`, means of the last minibatch [nat].
        """
        decisions = decision_batch(trajectory, self.presence)
        figures: dict[str, float] = {}
        for part in self.minibatches(decisions, len(trajectory), generator):
            score = self.network(part)
            log_prob = score.log_prob.mean()
            self.optimizer.zero_grad()
            (-log_prob).backward()
            self.optimizer.step()
            figures = {"log_prob": float(log_prob.detach()), "entropy": float(score.entropy.mean().detach())}
        return figures
