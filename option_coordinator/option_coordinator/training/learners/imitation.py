"""Behaviour cloning of recorded options, whatever chose them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from option_coordinator.data.trajectory import OptionTrajectory
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
    """Raises log pi-hat(o_U | o_not-U, s) of what was chosen, whatever it brought."""

    SETTINGS = ImitationSettings

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from what was chosen.

        Returns:
            `log_prob` of it and `entropy`, means of the last minibatch [nat].
        """
        decisions = decision_batch(trajectory, self.presence)
        figures: dict[str, float] = {}
        (optimizer,) = self.optimizers.values()
        for rows in self.minibatches(len(trajectory), generator):
            score = self.network(decisions.at(rows))
            log_prob = score.log_prob.mean()
            optimizer.zero_grad()
            (-log_prob).backward()
            optimizer.step()
            figures = {"log_prob": float(log_prob.detach()), "entropy": float(score.entropy.mean().detach())}
        return figures
