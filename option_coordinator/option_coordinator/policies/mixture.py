"""A mixture of products, sum_r w_r(s) prod_i p_ri(o_i | s): exact conditionals for any set of running agents.

Given what others run, it is a mixture again, with weights w'_r proportional to w_r prod_running p_rj(o_j):
log-probability and draw cost O(R sum_i K_i), for hundreds of robots.
"""

from __future__ import annotations

import numpy as np

from option_coordinator.options.decision import NONE, PolicyQuery
from option_coordinator.policies.joint_policy import (
    Array,
    Conditional,
    JointOptions,
    draw,
    log_sum_exp,
    most_likely,
)
from option_coordinator.policies.network import NetworkPolicy, Tensors, features, linear

_CLIMBERS = 3
_SWEEPS = 5
"""At most so many: robots wait for the answer."""


class Mixture(NetworkPolicy):
    """A mixture of R products.

    Args:
        tensors: Tensors of the trunk, of `weights` (R) and of `head` (R sum K).
        counts: Number of options of each agent.
    """

    def __init__(self, tensors: Tensors, counts: tuple[int, ...]) -> None:
        super().__init__(tensors, counts)
        self.rank = tensors["weights.bias"].shape[0]

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        x = features(self._tensors, query.observation)
        flat = linear(self._tensors, "head", x)
        if len(set(self.counts)) == 1:
            logits = flat.reshape(self.rank, *self.option_mask.shape).astype(float)
        else:
            logits = np.full((self.rank, *self.option_mask.shape), -np.inf)
            logits[:, self.option_mask] = flat.reshape(self.rank, -1)
        weights = linear(self._tensors, "weights", x).astype(float)
        return _MixtureConditional(self.counts, weights, logits, query)


class _MixtureConditional(Conditional):
    """The mixture's weights and factors, given what runs and what is legal."""

    def __init__(self, counts: tuple[int, ...], weights: Array, logits: Array, query: PolicyQuery) -> None:
        super().__init__(counts, query)
        running, legal = self.running, self.legal
        runs = np.flatnonzero(running != NONE)
        self._agents = np.flatnonzero(self.choosing)
        if len(runs):  # each sum of exponentials left out is a tenth of a small decision
            fixed = logits[:, runs]
            weights = weights + (fixed[:, np.arange(len(runs)), running[runs]] - log_sum_exp(fixed, -1)).sum(axis=1)
        allowed = logits[:, self._agents]
        share = log_sum_exp(allowed, -1)
        if not (legal[self._agents] | np.isneginf(allowed[0])).all():
            of_all, allowed = share, np.where(legal[self._agents], allowed, -np.inf)
            share = log_sum_exp(allowed, -1)
            weights = weights + (share - of_all).sum(axis=1)
        self._weights = weights - log_sum_exp(weights)
        self._factors = allowed - share[..., None]

    def log_prob(self, options: JointOptions) -> Array:
        chosen = np.asarray(options)[..., self._agents]
        terms = self._factors[:, np.arange(len(self._agents)), chosen].sum(axis=-1)
        return log_sum_exp(np.moveaxis(terms, 0, -1) + self._weights, -1)

    def sample(self, generator: np.random.Generator) -> JointOptions:
        component = int(draw(self._weights, generator))
        return self.with_chosen(draw(self._factors[component], generator))

    def _rough_mode(self) -> JointOptions:
        """Return the best of the components' own modes, improved agent by agent as long as that helps, if not for ever.

        Only the best few are improved: what the others begin from is far less likely.
        """
        starts = np.stack([self.with_chosen(np.argmax(factors, axis=-1)) for factors in self._factors])
        order = np.argsort(-self.log_prob(starts))[:_CLIMBERS]
        ends = np.stack([self._climb(starts[index]) for index in order])
        return ends[most_likely(self.log_prob(ends))]

    def _climb(self, options: JointOptions) -> JointOptions:
        """Change one agent's option after the other to its best, given the rest."""
        agents = np.arange(len(self._agents))
        chosen = options[self._agents]
        terms = self._weights + self._factors[:, agents, chosen].sum(axis=1)  # log w_r prod_i p_ri, of what is chosen
        for _ in range(_SWEEPS):
            before = chosen.copy()
            for agent in agents:
                rest = terms - self._factors[:, agent, chosen[agent]]
                chosen[agent] = most_likely(log_sum_exp(rest[:, None] + self._factors[:, agent], 0))
                terms = rest + self._factors[:, agent, chosen[agent]]
            if np.array_equal(chosen, before):
                break
        return self.with_chosen(chosen)
