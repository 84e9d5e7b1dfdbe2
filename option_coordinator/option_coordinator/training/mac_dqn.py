"""Mac-DQN (thesis 5.3.4): double Q-learning of joint options, with the same network as the other methods.

The best joint option is sought among those that agree with what the others run, in acting and in the target alike. The
published one has a recurrent network; like the policies that it is compared with, this one has none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from option_coordinator.errors import OptionError
from option_coordinator.joint_policy import Array, Conditional, JointPolicy, Options
from option_coordinator.options import Agent, Mask
from option_coordinator.policy_file import make_policy
from option_coordinator.training.heads import TableHead, as_numpy
from option_coordinator.training.learner import Arrays, Learner, as_choice, as_tensor
from option_coordinator.trajectory import Trajectory


@dataclass(frozen=True)
class MacDqnSettings:
    """The published ones, but for the exploration, which here is a part of the run.

    What is gathered between two updates, about a third of an episode, is a piece of the replay.

    Attributes:
        learning_rate: of Adam.
        batch: pieces of an update.
        replay: pieces that are kept.
        target_samples: low-level samples between two copies of the network into the target.
        exploration: part of the run over which epsilon falls from 1 to its end.
        epsilon_end: what it ends at.
        huber: where the loss turns linear.
        gradient_norm: at most this long.
    """

    learning_rate: float = 6e-4
    batch: int = 48
    replay: int = 3000
    target_samples: int = 5000
    exploration: float = 0.5
    epsilon_end: float = 0.1
    huber: float = 10.0
    gradient_norm: float = 10.0


class MacDqn(Learner):
    """Conditional double DQN over the joint table.

    Args:
        agents: whose options are learnt.
        discount: gamma of a low-level step, by which samples are counted in gamma^tau.
        settings: of the algorithm.
    """

    greedy = True
    network: TableHead

    def __init__(self, agents: Sequence[Agent], discount: float, settings: MacDqnSettings | None = None) -> None:
        self.settings = settings or MacDqnSettings()
        if not discount < 1.0:
            raise OptionError("mac_dqn: the discount must be below 1")
        self._log_discount = np.log(discount)
        counts = tuple(len(agent.options) for agent in agents)
        self.network = TableHead(sum(agent.observation_size for agent in agents), counts)
        self.target = deepcopy(self.network)
        self._optimizer = torch.optim.Adam(self.network.parameters(), self.settings.learning_rate)
        self._greedy = make_policy("table", as_numpy(self.network), counts, False)
        self._pieces: list[Trajectory] = []
        self._samples = self._copied = 0

    def behaviour(self, progress: float) -> JointPolicy:
        """Return the epsilon-greedy policy."""
        done = min(1.0, progress / self.settings.exploration)
        return EpsilonGreedy(self._greedy, 1.0 + done * (self.settings.epsilon_end - 1.0))

    def networks(self) -> Mapping[str, nn.Module]:
        """Return all networks by name."""
        return {"policy": self.network, "target": self.target}

    def optimizers(self) -> Mapping[str, torch.optim.Optimizer]:
        """Return all optimisers by name."""
        return {"policy_optimizer": self._optimizer}

    def memory(self) -> Arrays:
        """Return the replay and how far it is."""
        arrays: Arrays = {"counts": np.array([self._samples, self._copied])}
        if self._pieces:
            joined = Trajectory.joined(self._pieces)
            arrays |= {f"replay.{field.name}": getattr(joined, field.name) for field in fields(joined)}
        return arrays

    def recall(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take up what `memory` returned."""
        self._samples, self._copied = (int(count) for count in arrays["counts"])
        parts = {name.removeprefix("replay."): a for name, a in arrays.items() if name.startswith("replay.")}
        self._pieces = Trajectory(**parts).episodes() if parts else []

    def learn(self, trajectory: Trajectory, generator: np.random.Generator) -> dict[str, float]:
        """Keep what was gathered and take one step on a batch of what is kept.

        Returns:
            `value_loss`.
        """
        self._keep(trajectory)
        drawn = generator.integers(len(self._pieces), size=self.settings.batch)
        batch = Trajectory.joined([self._pieces[index] for index in drawn])
        choice = as_choice(batch)
        with torch.no_grad():
            targets = as_tensor(batch.reward) + as_tensor(batch.discount * ~batch.terminated) * self._next_values(batch)
        values = self.network.logits(choice.observation).gather(1, self.network.cell(choice.options)[:, None])[:, 0]
        loss = nn.functional.huber_loss(values, targets, delta=self.settings.huber)
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.gradient_norm)
        self._optimizer.step()
        return {"value_loss": float(loss.detach())}

    def _keep(self, trajectory: Trajectory) -> None:
        self._pieces += trajectory.episodes()
        del self._pieces[: -self.settings.replay]
        self._samples += int(np.log(trajectory.discount).sum() / self._log_discount + 0.5)
        if self._samples - self._copied >= self.settings.target_samples:
            self._copied = self._samples
            self.target.load_state_dict(self.network.state_dict())

    def _next_values(self, batch: Trajectory) -> torch.Tensor:
        """Return the target's value of what the network would choose next, given what runs on."""
        following = as_choice(batch)._replace(
            observation=as_tensor(batch.next_observation),
            options=torch.from_numpy(batch.next_running),
            choosing=torch.from_numpy(batch.next_running < 0),
            legal=torch.from_numpy(batch.next_legal),
        )
        allowed = self.network.allowed(following)
        best = self.network.logits(following.observation).masked_fill(~allowed, -torch.inf).argmax(dim=1)
        return self.target.logits(following.observation).gather(1, best[:, None])[:, 0]


class EpsilonGreedy(JointPolicy):
    """The most likely options, or with probability epsilon any legal ones.

    Args:
        policy: whose mode it takes.
        epsilon: how often it does not.
    """

    def __init__(self, policy: JointPolicy, epsilon: float) -> None:
        self.counts, self.observation_size = policy.counts, policy.observation_size
        self.epsilon = epsilon
        self._policy = policy

    def _given(self, observation: Array, choosing: Mask, running: Options, legal: Mask) -> Conditional:
        return _EpsilonGreedyConditional(self._policy.given(observation, choosing, running, legal), self.epsilon)


class _EpsilonGreedyConditional(Conditional):
    """See `EpsilonGreedy`."""

    def __init__(self, best: Conditional, epsilon: float) -> None:
        super().__init__(best.counts, best.choosing, best.running, best.legal)
        self._best = best.mode()
        self._epsilon = epsilon

    def log_prob(self, options: Options) -> Array:
        options = np.asarray(options)
        agents = np.flatnonzero(self.choosing)
        legal = self.legal[agents, options[..., agents]].all(axis=-1)
        same = (options == self._best)[..., agents].all(axis=-1)
        with np.errstate(divide="ignore"):
            return np.log(legal * self._epsilon / self.size + same * (1.0 - self._epsilon))

    def sample(self, generator: np.random.Generator) -> Options:
        out = self._best.copy()
        if generator.random() < self._epsilon:
            for agent in np.flatnonzero(self.choosing):
                out[agent] = generator.choice(np.flatnonzero(self.legal[agent]))
        return out

    def _rough_mode(self) -> Options:
        return self._best
