"""Joint policies given by networks, in NumPy: a joint table, a mixture of products, and an autoregressive chain."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from option_coordinator.options.options import NONE, PolicyQuery
from option_coordinator.policies.joint_policy import (
    Array,
    Conditional,
    JointOptions,
    JointPolicy,
    draw,
    log_sum_exp,
    most_likely,
)

Tensors = Mapping[str, Array]
_EPSILON = 1e-5  # as in torch


def linear(tensors: Tensors, name: str, x: Array) -> Array:
    """Return W x + b for x (..., in)."""
    return np.asarray(x @ tensors[f"{name}.weight"].T + tensors[f"{name}.bias"])


def layer_norm(tensors: Tensors, name: str, x: Array) -> Array:
    """Normalise x (..., n) to mean 0 and variance 1 over its components, then scale and shift it."""
    size = x.shape[-1]  # sums, because means take three times as long for few numbers
    centred = x - x.sum(axis=-1, keepdims=True) / size
    scale = np.sqrt((centred * centred).sum(axis=-1, keepdims=True) / size + _EPSILON)
    return np.asarray(centred / scale * tensors[f"{name}.weight"] + tensors[f"{name}.bias"])


def features(tensors: Tensors, x: Array) -> Array:
    """Return MAPPO's features (..., hidden) of an observation (..., n): norm, then twice linear, ReLU, norm."""
    x = layer_norm(tensors, "trunk.norm_0", x)
    for layer in (1, 2):
        x = layer_norm(tensors, f"trunk.norm_{layer}", np.maximum(linear(tensors, f"trunk.linear_{layer}", x), 0.0))
    return x


def part(tensors: Tensors, prefix: str) -> dict[str, Array]:
    """Select the tensors whose names start with a prefix, and remove the prefix."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


class NetworkPolicy(JointPolicy):
    """A joint policy with MAPPO's trunk; the size of the first norm is the observation's.

    Args:
        tensors: Tensors of the trunk and of the subclass's head, by name.
        counts: Number of options of each agent.
    """

    def __init__(self, tensors: Tensors, counts: tuple[int, ...]) -> None:
        self.counts = counts
        self.observation_size = tensors["trunk.norm_0.weight"].shape[0]
        self._tensors = tensors


class Autoregressive(NetworkPolicy):
    """pi-hat(o_U | o_not-U, s) = prod_i pi(o_i | known options, s), with i through U in agent order.

    The known options are initially those that the others run; each choice is then added, and absent agents are ignored.
    Every conditional is normalised, but those of different running sets need not belong to one joint distribution
    (arXiv 2205.13554).

    Args:
        tensors: Tensors of the trunk; `state` and `known`, whose sum is the hidden layer (`norm`); `head` (sum K).
        counts: Number of options of each agent.
    """

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        return _AutoregressiveConditional(self._tensors, self.counts, query)


class _AutoregressiveConditional(Conditional):
    """The chain of conditionals, given running and legal options."""

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
    """The table with the running options fixed and the absent agents marginalised out."""

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


_CLIMBERS = 3
_SWEEPS = 5
"""Maximum number of improvement sweeps, limited because robots wait for the answer."""


class Mixture(NetworkPolicy):
    """A mixture of R product distributions.

    sum_r w_r(s) prod_i p_ri(o_i | s) has exact conditionals for any set of running agents. Conditioned on running
    options, it is again a mixture, with weights w'_r proportional to w_r prod_running p_rj(o_j): log-probability and
    sampling cost O(R sum_i K_i), which suits hundreds of robots.

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
    """The mixture's weights and factors, given running and legal options."""

    def __init__(self, counts: tuple[int, ...], weights: Array, logits: Array, query: PolicyQuery) -> None:
        super().__init__(counts, query)
        running, legal = self.running, self.legal
        runs = np.flatnonzero(running != NONE)
        self._agents = np.flatnonzero(self.choosing)
        if len(runs):  # each omitted sum of exponentials saves a tenth of a small decision
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
        """Return the best of the components' modes after a limited number of improvements, agent by agent.

        Only the best few modes are improved, because the others are far less likely.
        """
        starts = np.stack([self.with_chosen(np.argmax(factors, axis=-1)) for factors in self._factors])
        order = np.argsort(-self.log_prob(starts))[:_CLIMBERS]
        ends = np.stack([self._climb(starts[index]) for index in order])
        return ends[most_likely(self.log_prob(ends))]

    def _climb(self, options: JointOptions) -> JointOptions:
        """Set each agent's option in turn to its best value, given the rest."""
        agents = np.arange(len(self._agents))
        chosen = options[self._agents]
        terms = self._weights + self._factors[:, agents, chosen].sum(axis=1)  # log w_r prod_i p_ri of chosen options
        for _ in range(_SWEEPS):
            before = chosen.copy()
            for agent in agents:
                rest = terms - self._factors[:, agent, chosen[agent]]
                chosen[agent] = most_likely(log_sum_exp(rest[:, None] + self._factors[:, agent], 0))
                terms = rest + self._factors[:, agent, chosen[agent]]
            if np.array_equal(chosen, before):
                break
        return self.with_chosen(chosen)
