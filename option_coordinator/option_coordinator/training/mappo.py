"""Asynchronous option-based MAPPO: Algorithm 3 with the conditional policy in roll-out and update alike (Eq. 5.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from option_coordinator.joint_policy import JointPolicy
from option_coordinator.options import Agent
from option_coordinator.policy_file import make_policy
from option_coordinator.training.heads import as_numpy, make_head
from option_coordinator.training.learner import Learner, as_choice, as_tensor
from option_coordinator.training.value import ValueNetwork
from option_coordinator.trajectory import Trajectory, advantages


@dataclass(frozen=True)
class MappoSettings:
    """The published ones.

    Attributes:
        learning_rate: of policy and value.
        clip: of the ratio, epsilon.
        entropy: coefficient of the entropy bonus.
        trace: lambda.
        epochs: of an update; each takes the whole batch at once.
        huber: where the value's loss turns linear, on its learnt scale.
        gradient_norm: at most this long.
    """

    learning_rate: float = 5e-4
    clip: float = 0.2
    entropy: float = 0.01
    trace: float = 0.95
    epochs: int = 10
    huber: float = 10.0
    gradient_norm: float = 10.0


class Mappo(Learner):
    """Conditional MAPPO; with `partial`, one policy for each agent (Eq. 5.5) and still one value of all.

    Args:
        agents: whose options are learnt.
        head: kind of joint policy.
        partial: whether each agent has one of its own.
        settings: of the algorithm.
    """

    greedy = False

    def __init__(
        self, agents: Sequence[Agent], head: str, partial: bool = False, settings: MappoSettings | None = None
    ) -> None:
        self.settings = settings or MappoSettings()
        counts = tuple(len(agent.options) for agent in agents)
        self.network = make_head(head, agents, partial)
        self.value = ValueNetwork(sum(agent.observation_size for agent in agents), counts)
        self._optimizers = {
            name: torch.optim.Adam(network.parameters(), self.settings.learning_rate, eps=1e-5)
            for name, network in self.networks().items()
        }
        self._policy = make_policy(head, as_numpy(self.network), counts, partial)

    def behaviour(self, progress: float) -> JointPolicy:  # noqa: ARG002 - it explores by its own draws
        """Return the policy, which goes on changing as it learns."""
        return self._policy

    def networks(self) -> Mapping[str, nn.Module]:
        """Return all networks by name."""
        return {"policy": self.network, "value": self.value}

    def optimizers(self) -> Mapping[str, torch.optim.Optimizer]:
        """Return all optimisers by name."""
        return {f"{name}_optimizer": optimizer for name, optimizer in self._optimizers.items()}

    def learn(self, trajectory: Trajectory, generator: np.random.Generator) -> dict[str, float]:  # noqa: ARG002
        """Learn from what was gathered.

        Returns:
            `ratio`: how far the first epoch's ratios are from 1 at most; `entropy` of the choices; `value_loss`.
        """
        observation = as_tensor(trajectory.observation)
        running = torch.from_numpy(trajectory.running)
        with torch.no_grad():
            values = self.value.values(observation, running)
            after = self.value.values(as_tensor(trajectory.next_observation), torch.from_numpy(trajectory.next_running))
        gains = advantages(trajectory, values.double().numpy(), after.double().numpy(), self.settings.trace)
        returns = as_tensor(gains) + values
        gain = as_tensor((gains - gains.mean()) / (gains.std() + 1e-5))
        old = as_tensor(trajectory.log_prob)
        choice = as_choice(trajectory)
        figures: dict[str, float] = {}
        for epoch in range(self.settings.epochs):
            score = self.network(choice)
            ratio = torch.exp(score.log_prob - old)
            if epoch == 0:
                figures["ratio"] = float((ratio - 1.0).abs().max().detach())
            clipped = ratio.clamp(1.0 - self.settings.clip, 1.0 + self.settings.clip)
            loss = -torch.minimum(ratio * gain, clipped * gain).mean()
            self._step("policy", loss - self.settings.entropy * score.entropy.mean())
            targets = self.value.rescale(returns)
            value_loss = nn.functional.huber_loss(self.value(observation, running), targets, delta=self.settings.huber)
            self._step("value", value_loss)
            figures |= {"entropy": float(score.entropy.mean().detach()), "value_loss": float(value_loss.detach())}
        return figures

    def _step(self, name: str, loss: Tensor) -> None:
        optimizer = self._optimizers[name]
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.networks()[name].parameters(), self.settings.gradient_norm)
        optimizer.step()
