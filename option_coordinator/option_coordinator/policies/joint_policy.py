"""The conditional joint policy pi-hat(o_U | o_not-U, s) of thesis Eq. 5.2 and 5.3: one interface for all kinds.

    conditional = policy.given(observation, choosing, running, legal)
    options = conditional.sample(generator)

`choosing` marks the agents that need an option (U); the policy is conditioned on those that run one. An agent that
neither chooses nor runs anything is absent, and its option is marginalised out. Legality masks restrict the joint
policy to joint options with a legal chosen part, and renormalise it. NumPy only, because this code runs on robots.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError
from option_coordinator.options.options import NONE, Mask, PolicyQuery, option_mask

Array = NDArray[np.floating]
JointOptions = NDArray[np.int64]
ENUMERABLE = 4096
"""Maximum number of joint options enumerated for the entropy, which takes milliseconds."""
MODE_ENUMERABLE = 128
"""Maximum number enumerated for the mode, within tenths of a millisecond, because robots wait for it."""
_DRAWS = 1000
_NOT_FINITE = "the policy's probabilities are not finite: nothing can be chosen by them"


class Conditional(ABC):
    """The distribution pi-hat(. | o_not-U, s) over the choosing agents' options.

    Attributes:
        counts: Number of options of each of the N agents.
        choosing: Whether each agent chooses (N,).
        running: Option of each running agent; `NONE` for the others (N,).
        legal: Whether each agent may choose each option (N, K).
    """

    def __init__(self, counts: Sequence[int], query: PolicyQuery) -> None:
        self.counts, self.choosing, self.legal = tuple(counts), query.choosing, query.legal
        self.running = np.where(query.choosing, NONE, query.running)

    @abstractmethod
    def log_prob(self, options: JointOptions) -> Array:
        """Return log pi-hat (...,) of options (..., N); only choosing agents count, and illegal options give -inf."""

    @abstractmethod
    def sample(self, generator: np.random.Generator) -> JointOptions:
        """Return options (N,): samples for choosing agents, running options of others, `NONE` for absent ones."""

    def mode(self) -> JointOptions:
        """Return the most likely options (N,); beyond `MODE_ENUMERABLE` joint options an approximation."""
        if self.size > MODE_ENUMERABLE:
            return self._rough_mode()
        choices = self.choices()
        return choices[most_likely(self.log_prob(choices))]

    def entropy(self) -> float:
        """Return the entropy [nat]; beyond `ENUMERABLE` joint options a reproducible estimate from 1000 samples."""
        if self.size > ENUMERABLE:
            generator = np.random.default_rng(0)
            draws = np.stack([self.sample(generator) for _ in range(_DRAWS)])
            return float(-self.log_prob(draws).mean())
        logs = self.log_prob(self.choices())
        return float(-np.sum(np.exp(logs) * logs))

    def with_chosen(self, chosen: JointOptions | Sequence[Any]) -> JointOptions:
        """Return joint options (N,): chosen ones, running ones of other agents, and `NONE` for absent agents."""
        out = self.running.copy()
        out[self.choosing] = chosen
        return out

    @property
    def size(self) -> int:
        """Number of legal joint options."""
        return math.prod(len(row) for row in self._legal_options)

    def choices(self) -> JointOptions:
        """Return all legal joint options (size, N)."""
        out = np.tile(self.running, (self.size, 1))
        out[:, self.choosing] = list(product(*self._legal_options))
        return out

    @cached_property
    def _legal_options(self) -> list[JointOptions]:
        return [np.flatnonzero(self.legal[agent]) for agent in np.flatnonzero(self.choosing)]

    @abstractmethod
    def _rough_mode(self) -> JointOptions:
        """Return likely options without enumerating all."""


class JointPolicy(ABC):
    """A joint policy pi(o | s) of N agents, any of which may choose while the others run options.

    Attributes:
        counts: Number of options of each agent.
        observation_size: Length of the joint observation.
    """

    counts: tuple[int, ...]
    observation_size: int

    @cached_property
    def option_mask(self) -> Mask:
        """Whether each agent has each option, (N, K) with K the maximum count."""
        return option_mask(self.counts)

    @cached_property
    def _counts(self) -> JointOptions:
        return np.array(self.counts)

    def given(
        self, observation: Array, choosing: Mask, running: JointOptions, legal: Mask | None = None
    ) -> Conditional:
        """Return pi-hat for one decision.

        Args:
            observation: Observations of all agents, concatenated (observation_size,).
            choosing: Whether each agent chooses; agents that run an option do not (N,).
            running: Option of each running agent; `NONE` for the others (N,).
            legal: Whether each agent may choose each option (N, K), K the maximum count; all by default.

        Raises:
            OptionError: Sizes are wrong, the observation is not finite, options are out of range, or none is legal.
        """
        legal = self.option_mask if legal is None else np.asarray(legal, dtype=bool)
        if legal.shape != self.option_mask.shape:
            raise OptionError(f"legal has shape {legal.shape}, must be {self.option_mask.shape}")
        legal = legal & self.option_mask
        query = PolicyQuery(np.asarray(observation), np.asarray(choosing, dtype=bool), np.asarray(running), legal)
        self._check(query)
        return self.valid(query)

    def choose(
        self, query: PolicyQuery, generator: np.random.Generator | None = None
    ) -> tuple[JointOptions, Conditional]:
        """Return options (N,), sampled with the generator or else the most likely ones, and pi-hat; see `given`."""
        conditional = self.given(query.observation, query.choosing, query.running, query.legal)
        return conditional.mode() if generator is None else conditional.sample(generator), conditional

    @abstractmethod
    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat without validating the decision, which must be valid, e.g. from `OptionEnvironment`."""

    def _check(self, query: PolicyQuery) -> None:
        observation, choosing, running = query.observation, query.choosing, query.running
        agents = len(self.counts)
        if observation.shape != (self.observation_size,):
            raise OptionError(f"observation has shape {observation.shape}, must be ({self.observation_size},)")
        if not np.isfinite(observation).all():
            raise OptionError(f"observation: {int((~np.isfinite(observation)).sum())} numbers are not finite")
        if choosing.shape != (agents,) or running.shape != (agents,):
            raise OptionError(
                f"choosing and running have shapes {choosing.shape}, {running.shape}, must be ({agents},)"
            )
        if (~choosing & ((running < NONE) | (running >= self._counts))).any():
            raise OptionError(f"running options {running.tolist()} are not all below {list(self.counts)}")
        stuck = np.flatnonzero(choosing & ~query.legal.any(axis=1))
        if len(stuck):
            raise OptionError(f"agent {int(stuck[0])} has no legal option")


def log_sum_exp(x: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    """Return log sum exp; -inf if all terms are -inf."""
    top = np.maximum.reduce(x, axis=axis, keepdims=True, initial=-np.inf)  # the methods take twice as long
    if np.isfinite(top).all():  # the usual case; the general one costs more
        out = np.log(np.add.reduce(np.exp(x - top), axis=axis, keepdims=True)) + top
    else:
        safe = np.where(np.isfinite(top), top, 0.0)
        with np.errstate(divide="ignore"):
            out = np.log(np.exp(x - safe).sum(axis=axis, keepdims=True)) + safe
    return np.squeeze(out, axis=axis) if axis is not None else out.reshape(())


def draw(log_probabilities: Array, generator: np.random.Generator) -> JointOptions:
    """Sample (...) from each row of normalised log-probabilities (..., K).

    Raises:
        OptionError: The log-probabilities are NaN, e.g. because a network's observations or weights are too large.
    """
    total = np.cumsum(np.exp(log_probabilities), axis=-1)
    if not np.isfinite(total[..., -1]).all():
        raise OptionError(_NOT_FINITE)
    # Scaled by the last sum, so that rounding cannot put a sample beyond the last option.
    level = generator.random(total.shape[:-1])[..., None] * total[..., -1:]
    return np.asarray((total <= level).sum(axis=-1))


def most_likely(log_probabilities: Array) -> int:
    """Return the flat index of the maximum.

    Raises:
        OptionError: As for `draw`.
    """
    best = int(np.argmax(log_probabilities))  # the first NaN, if there is one
    if not np.isfinite(log_probabilities.flat[best]):
        raise OptionError(_NOT_FINITE)
    return best
