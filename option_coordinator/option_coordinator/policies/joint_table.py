"""The thesis's joint policy: one probability for each joint option (Fig. 5.2). Exact, and exponential in the robots."""

from __future__ import annotations

import numpy as np

from option_coordinator.options.decision import NONE
from option_coordinator.options.options import Mask
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

    def _given(self, observation: Array, choosing: Mask, running: JointOptions, legal: Mask) -> Conditional:
        return _TableConditional(self._logits(observation), choosing, running, legal)

    def _logits(self, observation: Array) -> Array:
        return linear(self._tensors, "head", features(self._tensors, observation)).reshape(self.counts)


class _TableConditional(Conditional):
    """The table where the running options are fixed and the absent agents are summed out."""

    def __init__(self, logits: Array, choosing: Mask, running: JointOptions, legal: Mask) -> None:
        super().__init__(logits.shape, choosing, running, legal)
        runs = ~choosing & (running != NONE)
        table = logits[tuple(int(o) if fixed else slice(None) for o, fixed in zip(running, runs, strict=True))]
        absent = tuple(int(axis) for axis in np.flatnonzero(~choosing[~runs]))
        table = log_sum_exp(table, absent) if absent else np.asarray(table)
        for axis, agent in enumerate(np.flatnonzero(choosing)):
            row = legal[agent, : self.counts[agent]]
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
