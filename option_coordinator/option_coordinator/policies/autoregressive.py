"""An any-order autoregressive joint policy: each chooser in turn, given whatever is already known of the others.

What the others run comes first, then each choice joins what is known; who is absent never does. Every conditional is
normalised, but those of different running sets need not share one joint (arXiv 2205.13554).
"""

from __future__ import annotations

from collections.abc import Callable

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
from option_coordinator.policies.network import NetworkPolicy, Tensors, features, layer_norm, linear


class Autoregressive(NetworkPolicy):
    """pi-hat(o_U | o_not-U, s) = prod_i pi(o_i | known options, s), i through U in the order of the agents.

    Args:
        tensors: Tensors of the trunk; `state` and `known`, whose sum is the hidden layer (`norm`); `head` (sum K).
        counts: Number of options of each agent.
    """

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        return _AutoregressiveConditional(self._tensors, self.counts, query)


class _AutoregressiveConditional(Conditional):
    """The chain of conditionals, given what runs and what is legal."""

    def __init__(self, tensors: Tensors, counts: tuple[int, ...], query: PolicyQuery) -> None:
        super().__init__(counts, query)
        self._tensors = tensors
        self._begin = np.concatenate(([0], np.cumsum(counts)))
        self._known = tensors["known.weight"]
        runs = np.flatnonzero(self.running != NONE)
        hidden = linear(tensors, "state", features(tensors, query.observation))
        self._hidden = hidden + self._known[:, self._begin[runs] + self.running[runs]].sum(axis=1)

    def log_prob(self, options: JointOptions) -> Array:
        options = np.asarray(options)
        hidden = np.broadcast_to(self._hidden, (*options.shape[:-1], len(self._hidden)))
        total = np.zeros(options.shape[:-1])
        for agent in np.flatnonzero(self.choosing):
            chosen = options[..., agent]
            logs = self._logs(hidden, int(agent))
            total = total + np.take_along_axis(logs, chosen[..., None], axis=-1)[..., 0]
            hidden = hidden + self._known.T[self._begin[agent] + chosen]
        return total

    def sample(self, generator: np.random.Generator) -> JointOptions:
        return self._chain(lambda logs: int(draw(logs, generator)))

    def _rough_mode(self) -> JointOptions:
        """Return each agent's most likely option in turn."""
        return self._chain(most_likely)

    def _chain(self, choose: Callable[[Array], int]) -> JointOptions:
        hidden, out = self._hidden, self.running.copy()
        for agent in np.flatnonzero(self.choosing):
            out[agent] = choose(self._logs(hidden, int(agent)))
            hidden = hidden + self._known[:, self._begin[agent] + out[agent]]
        return out

    def _logs(self, hidden: Array, agent: int) -> Array:
        """Return an agent's log-probabilities (..., K_i) for hidden layers (..., H)."""
        x = layer_norm(self._tensors, "norm", np.maximum(hidden, 0.0))
        own = slice(self._begin[agent], self._begin[agent + 1])
        logits = x @ self._tensors["head.weight"][own].T + self._tensors["head.bias"][own]
        logits = np.where(self.legal[agent, : self.counts[agent]], logits, -np.inf)
        return np.asarray(logits - log_sum_exp(logits, -1)[..., None])
