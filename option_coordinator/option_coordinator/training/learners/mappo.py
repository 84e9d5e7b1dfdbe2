"""Asynchronous option-based MAPPO: Algorithm 3 with the conditional policy in both roll-out and update (Eq. 5.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from option_coordinator.data.trajectory import OptionTrajectory, advantages
from option_coordinator.options.options import Agent
from option_coordinator.policies.partial import with_presence
from option_coordinator.training.heads.head_parts import DecisionBatch, ValueNetwork
from option_coordinator.training.learners.learner import GradientLearner, Rows, as_tensor, decision_batch


@dataclass(frozen=True)
class MappoSettings:
    """The published settings, except for the minibatch (in Water Filling, all data between updates).

    Attributes:
        learning_rate: Learning rate of policy and value.
        clip: Clipping range epsilon of the probability ratio.
        entropy: Coefficient of the entropy bonus.
        gae_lambda: Coefficient lambda of the generalised advantage estimate.
        epochs: Number of passes over the data per update.
        minibatch: Approximate number of option steps of a minibatch.
        huber: Error at which the value's loss turns linear, on the normalised scale.
        gradient_norm: Maximum norm of the gradient.
    """

    learning_rate: float = 5e-4
    clip: float = 0.2
    entropy: float = 0.01
    gae_lambda: float = 0.95
    epochs: int = 10
    minibatch: int = 256
    huber: float = 10.0
    gradient_norm: float = 10.0


class Mappo(GradientLearner):
    """Conditional MAPPO; with `partial`, one policy per agent (Eq. 5.5) but still one joint value function."""

    SETTINGS = MappoSettings
    ADAM_EPSILON = 1e-5

    def other_networks(self, agents: Sequence[Agent]) -> Mapping[str, nn.Module]:
        """Return the value network."""
        size = sum(agent.observation_size for agent in agents) + self.presence * len(agents)
        self.value = ValueNetwork(size, [len(agent.options) for agent in agents])
        return {"value": self.value}

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from a trajectory.

        Returns:
            `ratio`: maximum deviation of the first ratios from 1; `entropy` of the choices; `value_loss`.
        """
        figures: dict[str, float] = {}
        batch = self._batch(trajectory)
        for rows in self.minibatches(len(trajectory), generator):
            found = self._step(batch.at(rows))
            figures = found | ({"ratio": figures["ratio"]} if figures else {})
        return figures

    def learn_value(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> None:
        """Learn only the value function from a trajectory, leaving the policy unchanged."""
        batch = self._batch(trajectory)
        for rows in self.minibatches(len(trajectory), generator):
            self.descend(self._value_loss(batch.at(rows)))

    def _batch(self, trajectory: OptionTrajectory) -> _Batch:
        decisions = decision_batch(trajectory, self.presence)
        running = torch.from_numpy(trajectory.running)
        following = trajectory.next_observation
        if self.presence:
            following = with_presence(following, trajectory.next_present)
        with torch.no_grad():
            values = self.value.values(decisions.observation, running)
            after = self.value.values(as_tensor(following), torch.from_numpy(trajectory.next_running))
        gains = advantages(trajectory, values.double().numpy(), after.double().numpy(), self.settings.gae_lambda)
        return _Batch(
            decisions=decisions,
            running=running,
            log_prob=as_tensor(trajectory.log_prob),
            gain=as_tensor((gains - gains.mean()) / (gains.std() + 1e-5)),
            returns=as_tensor(gains) + values,
        )

    def _step(self, batch: _Batch) -> dict[str, float]:
        settings = self.settings
        score = self.network(batch.decisions)
        ratio = torch.exp(score.log_prob - batch.log_prob)
        clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
        entropy = score.entropy.mean()
        loss = -torch.minimum(ratio * batch.gain, clipped * batch.gain).mean() - settings.entropy * entropy
        value_loss = self._value_loss(batch)
        self.descend(loss + value_loss)  # the two share no parameters
        return {
            "ratio": float((ratio - 1.0).abs().max().detach()),
            "loss": float(loss.detach()),
            "entropy": float(entropy.detach()),
            "value_loss": float(value_loss.detach()),
        }

    def _value_loss(self, batch: _Batch) -> Tensor:
        targets = self.value.scale.count(batch.returns)
        values = self.value(batch.decisions.observation, batch.running)
        return nn.functional.huber_loss(values, targets, delta=self.settings.huber)


class _Batch(NamedTuple):
    """Batch of an update, as tensors (B, ...)."""

    decisions: DecisionBatch
    running: Tensor
    log_prob: Tensor
    gain: Tensor
    returns: Tensor

    def at(self, rows: Rows) -> _Batch:
        """Select rows."""
        decisions, *rest = self
        return _Batch(decisions.at(rows), *(part[rows] for part in rest))


@dataclass(frozen=True)
class WeightedImitationSettings(MappoSettings):
    """Settings of weighted imitation, in addition to MAPPO's for the value function.

    Attributes:
        temperature: Advantage, in standard deviations, that increases a weight by a factor of e.
        largest_weight: Upper limit of a weight.
    """

    temperature: float = 0.5
    largest_weight: float = 20.0


class WeightedImitation(Mappo):
    """Maximises log pi-hat(o_U | o_not-U, s) of options, weighted by their advantage.

    Behaviour cloning weighted by exp(advantage / temperature): Wang et al. 2018 (MARWIL), with the joint conditional
    policy in place of a single agent's and gamma^tau in place of gamma. The rewards in the bags select the options to
    imitate, regardless of the policy that chose them.
    """

    SETTINGS = WeightedImitationSettings

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from recorded options.

        Returns:
            Weighted `log_prob` of the options, `entropy` and `value_loss` of the last minibatch.
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
            self.descend(value_loss - log_prob)  # the two share no parameters
            figures = {
                "loss": float((value_loss - log_prob).detach()),
                "log_prob": float(log_prob.detach()),
                "entropy": float(score.entropy.mean().detach()),
                "value_loss": float(value_loss.detach()),
            }
        return figures
