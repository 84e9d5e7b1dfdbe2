"""Imitation of recorded options as far as they paid: cloning weighted by exp(advantage / temperature).

Wang et al. 2018 (MARWIL), with the joint conditional policy in place of a single agent's and gamma^tau in place of
gamma. Whatever chose the options, the rewards in the bags say which of them to keep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.training.learners.mappo import Mappo, MappoSettings


@dataclass(frozen=True)
class WeightedImitationSettings(MappoSettings):
    """Settings of weighted imitation, beside MAPPO's for the value.

    Attributes:
        temperature: Advantage that multiplies a weight by e, in standard deviations.
        largest_weight: Limit of a weight.
    """

    temperature: float = 0.5
    largest_weight: float = 20.0


class WeightedImitation(Mappo):
    """Raises log pi-hat(o_U | o_not-U, s) of the options that brought more than the value expected."""

    SETTINGS = WeightedImitationSettings

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from recorded options.

        Returns:
            `log_prob` of the options, weighted, `entropy`, and `value_loss`, of the last minibatch.
        """
        settings: WeightedImitationSettings = self.settings
        figures: dict[str, float] = {}
        everything = self._batch(trajectory)
        for rows in self.minibatches(len(trajectory), generator):
            batch = everything.at(rows)
            score = self.network(batch.decisions)
            weights = torch.exp(batch.gain / settings.temperature).clamp(max=settings.largest_weight)
            log_prob = (weights * score.log_prob).sum() / weights.sum()
            value_loss = self._value_loss(batch)
            self.descend(value_loss - log_prob)  # they share no parameter
            figures = {
                "log_prob": float(log_prob.detach()),
                "entropy": float(score.entropy.mean().detach()),
                "value_loss": float(value_loss.detach()),
            }
        return figures
