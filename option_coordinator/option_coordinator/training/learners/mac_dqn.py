"""Mac-DQN (thesis 5.3.4): double Q-learning of joint options, with the same network as the other methods.

Both acting and the target maximise over the joint options that agree with the running ones. Unlike the published
version, the network is not recurrent, as in the policies it is compared with. Q is normalised by running statistics,
like V in the other methods; without this, a few thousand steps would not reach returns of 190.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from ctrl_rl_learning.torch import Arrays, ReplayBuffer
from numpy.typing import NDArray
from torch import Tensor, nn

from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.options.options import Agent, PolicyQuery
from option_coordinator.policies.joint_policy import Array, Conditional, JointOptions, JointPolicy
from option_coordinator.policies.policy_file import make_policy
from option_coordinator.training.heads.head_parts import ValueNorm
from option_coordinator.training.heads.heads import TableHead, as_numpy
from option_coordinator.training.learners.learner import Learner, as_tensor, decision_batch


class EpsilonGreedy(JointPolicy):
    """Takes the most likely options or, with probability epsilon, random legal ones.

    Args:
        policy: Policy that provides the most likely options.
        epsilon: Probability of a random legal joint option instead, 0 to 1.
    """

    def __init__(self, policy: JointPolicy, epsilon: float) -> None:
        self.counts, self.observation_size = policy.counts, policy.observation_size
        self.epsilon = epsilon
        self._policy = policy

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        return _EpsilonGreedyConditional(self._policy, query, self.epsilon)


class _EpsilonGreedyConditional(Conditional):
    """Conditional distribution of `EpsilonGreedy`."""

    def __init__(self, policy: JointPolicy, query: PolicyQuery, epsilon: float) -> None:
        super().__init__(policy.counts, query)
        self._best = policy.valid(query).mode()
        self._epsilon = epsilon

    def log_prob(self, options: JointOptions) -> Array:
        options = np.asarray(options)
        agents = np.flatnonzero(self.choosing)
        legal = self.legal[agents, options[..., agents]].all(axis=-1)
        same = (options == self._best)[..., agents].all(axis=-1)
        with np.errstate(divide="ignore"):
            return np.log(legal * self._epsilon / self.size + same * (1.0 - self._epsilon))

    def sample(self, generator: np.random.Generator) -> JointOptions:
        out = self._best.copy()
        if generator.random() < self._epsilon:
            for agent in np.flatnonzero(self.choosing):
                out[agent] = generator.choice(np.flatnonzero(self.legal[agent]))
        return out

    def _rough_mode(self) -> JointOptions:
        return self._best


@dataclass(frozen=True)
class MacDqnSettings:
    """The published settings, as far as they apply to a non-recurrent network.

    Batch and replay sizes are in option steps, roughly equal to the published 16 and 1000 episodes. The discount is
    that of the other methods instead of 1, and the exploration is a fraction of the run, because runs differ in length.

    Attributes:
        learning_rate: Learning rate of Adam.
        batch: Number of option steps per update.
        replay: Capacity of the replay in option steps.
        update_samples: Number of low-level samples between two updates.
        target_samples: Number of low-level samples between target network updates.
        exploration: Fraction of the run over which epsilon falls from 1 to `epsilon_end`.
        epsilon_end: Value of epsilon after the exploration.
        huber: Error at which the loss turns linear, on the normalised scale.
        gradient_norm: Maximum norm of the gradient.
    """

    learning_rate: float = 6e-4
    batch: int = 512
    replay: int = 50_000
    update_samples: int = 30
    target_samples: int = 5000
    exploration: float = 0.5
    epsilon_end: float = 0.1
    huber: float = 10.0
    gradient_norm: float = 10.0


class MacDqn(Learner):
    """Conditional double DQN over the joint table.

    Args:
        agents: Agents whose options are learned.
        settings: Settings of the algorithm; the default ones if omitted.
    """

    greedy = True
    network: TableHead

    def __init__(self, agents: Sequence[Agent], settings: MacDqnSettings | None = None) -> None:
        self.settings = settings or MacDqnSettings()
        counts = tuple(len(agent.options) for agent in agents)
        self.network = TableHead(sum(agent.observation_size for agent in agents), counts)
        self.target = deepcopy(self.network)
        self.scale, self.target_scale = ValueNorm(), ValueNorm()
        self.networks = {
            "policy": self.network,
            "target": self.target,
            "scale": self.scale,
            "target_scale": self.target_scale,
        }
        adam = torch.optim.Adam(self.network.parameters(), self.settings.learning_rate, fused=True)
        self.optimizers = {"policy_optimizer": adam}
        self._best = make_policy("table", as_numpy(self.network), counts, False)
        self._replay = ReplayBuffer(self.settings.replay)
        self._samples = self._copied = 0

    def behaviour(self, progress: float) -> JointPolicy:
        """Return the epsilon-greedy policy."""
        done = min(1.0, progress / self.settings.exploration)
        return EpsilonGreedy(self._best, 1.0 + done * (self.settings.epsilon_end - 1.0))

    def memory(self) -> Arrays:
        """Return the replay and the counters."""
        replay = {f"replay.{name}": array for name, array in self._replay.arrays().items()}
        return {"counts": np.array([self._samples, self._copied]), **replay}

    def recall(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore the state returned by `memory`."""
        self._samples, self._copied = (int(count) for count in arrays["counts"])
        self._replay.restore({n.removeprefix("replay."): a for n, a in arrays.items() if n.startswith("replay.")})

    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Store a trajectory and take one step on a batch from the replay.

        Returns:
            `value_loss`, on the normalised scale.
        """
        self._replay.add(vars(trajectory))
        self._samples += int(trajectory.duration.sum())
        if self._samples - self._copied >= self.settings.target_samples:
            self._copied = self._samples
            self.target.load_state_dict(self.network.state_dict())
            self.target_scale.load_state_dict(self.scale.state_dict())
        rows = self._replay.draw(self.settings.batch, generator)
        batch = OptionTrajectory(**{**rows, "last": np.ones(self.settings.batch, dtype=bool)})  # each separately
        decisions = decision_batch(batch)
        with torch.no_grad():
            onward = as_tensor(batch.discount * ~batch.terminated)
            targets = self.scale.count(as_tensor(batch.reward) + onward * self._next_values(batch))
        values = self.network.logits(decisions.observation).gather(1, self.network.cell(decisions.options)[:, None])[
            :, 0
        ]
        loss = nn.functional.huber_loss(values, targets, delta=self.settings.huber)
        self.descend(loss)
        return {"loss": float(loss.detach()), "value_loss": float(loss.detach())}

    def _next_values(self, batch: OptionTrajectory) -> Tensor:
        """Return the target network's value of the online network's next choice, given the running options [reward]."""
        following = decision_batch(batch)._replace(
            observation=as_tensor(batch.next_observation),
            options=torch.from_numpy(batch.next_running),
            choosing=torch.from_numpy(batch.next_running < 0),
            legal=torch.from_numpy(batch.next_legal),
        )
        allowed = self.network.allowed(following)
        best = self.network.logits(following.observation).masked_fill(~allowed, -torch.inf).argmax(dim=1)
        values = self.target.logits(following.observation).gather(1, best[:, None])[:, 0]
        # On the target's own scale, so that targets stay fixed between two updates.
        return self.target_scale.undo(values)
