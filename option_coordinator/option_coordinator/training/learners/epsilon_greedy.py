"""Exploration of Q-learning: the best options, now and then any legal ones."""

from __future__ import annotations

import numpy as np

from option_coordinator.options.decision import PolicyQuery
from option_coordinator.policies.joint_policy import Array, Conditional, JointOptions, JointPolicy


class EpsilonGreedy(JointPolicy):
    """The most likely options, or with probability epsilon any legal ones.

    Args:
        policy: Policy whose most likely options are taken.
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
    """See `EpsilonGreedy`."""

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
