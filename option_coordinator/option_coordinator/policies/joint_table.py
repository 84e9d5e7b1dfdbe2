"""The thesis's joint policy: one probability for each joint option (Fig. 5.2). Exact, and exponential in the robots."""

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
from option_coordinator.policies.network import NetworkPolicy, features, linear


class JointTable(NetworkPolicy):
    """pi(o | s) as a table (K_0, ..., K_N-1).

    Args:
        tensors: Tensors of the trunk and of `head` (cells).
        counts: Number of options of each agent.
    """

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        return _TableConditional(self._logits(query.observation), query)

    def _logits(self, observation: Array) -> Array:
        return linear(self._tensors, "head", features(self._tensors, observation)).reshape(self.counts)


class _TableConditional(Conditional):
    """The table where the running options are fixed and the absent agents are summed out."""

    def __init__(self, logits: Array, query: PolicyQuery) -> None:
        super().__init__(logits.shape, query)
        table = logits[tuple(slice(None) if option == NONE else int(option) for option in self.running)]
        absent = tuple(int(axis) for axis in np.flatnonzero(~self.choosing[self.running == NONE]))
        table = log_sum_exp(table, absent) if absent else np.asarray(table)
        for axis, agent in enumerate(np.flatnonzero(self.choosing)):
            row = self.legal[agent, : self.counts[agent]]
            table = np.where(row.reshape((-1, *(1,) * (table.ndim - axis - 1))), table, -np.inf)
        self._table = table - log_sum_exp(table)

    def log_prob(self, options: JointOptions) -> Array:
        chosen = np.asarray(options)[..., self.choosing]
        if chosen.shape[-1] == 0:
            return np.zeros(chosen.shape[:-1])
        return np.asarray(self._table[tuple(np.moveaxis(chosen, -1, 0))])

    def sample(self, generator: np.random.Generator) -> JointOptions:
        return self._options(int(draw(self._table.ravel(), generator)))

    def mode(self) -> JointOptions:
        return self._options(most_likely(self._table))

    def entropy(self) -> float:
        logs = self._table[np.isfinite(self._table)]
        return float(-np.sum(np.exp(logs) * logs))

    def _options(self, cell: int) -> JointOptions:
        return self.with_chosen(np.unravel_index(cell, self._table.shape) if self._table.ndim else ())

    def _rough_mode(self) -> JointOptions:
        return self.mode()
