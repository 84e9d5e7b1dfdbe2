"""Partially centralised choice (thesis Eq. 5.5): each agent knows its own observation and the others' running options.

Agent i uses its own joint policy pi^i for its own option only: pi^i(o_i, o_not-U | s_i) / pi^i(o_not-U | s_i). Agents
that choose simultaneously do not know each other's choice.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from option_coordinator.options.options import NONE, Mask, PolicyQuery
from option_coordinator.policies.joint_policy import Array, Conditional, JointOptions, JointPolicy


class Partial(JointPolicy):
    """One joint policy per agent, used for that agent's choice.

    Args:
        policies: Joint policies over all agents' options, one per agent, each given that agent's observation.
    """

    def __init__(self, policies: Sequence[JointPolicy]) -> None:
        self.counts = policies[0].counts
        self.observation_size = sum(policy.observation_size for policy in policies)
        self._policies = tuple(policies)
        self._ends = np.cumsum([policy.observation_size for policy in policies])[:-1]

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        parts, running = {}, np.where(query.choosing, NONE, query.running)
        for agent, own in enumerate(np.split(query.observation, self._ends)):
            if query.choosing[agent]:
                alone = np.arange(len(self.counts)) == agent
                parts[agent] = self._policies[agent].valid(PolicyQuery(own, alone, running, query.legal))
        return _PartialConditional(self.counts, query, parts)


class _PartialConditional(Conditional):
    """The product of the choosing agents' own conditionals."""

    def __init__(self, counts: tuple[int, ...], query: PolicyQuery, parts: dict[int, Conditional]) -> None:
        super().__init__(counts, query)
        self._parts = parts

    def log_prob(self, options: JointOptions) -> Array:
        options = np.asarray(options)
        return np.sum([part.log_prob(options) for part in self._parts.values()], axis=0) + np.zeros(options.shape[:-1])

    def sample(self, generator: np.random.Generator) -> JointOptions:
        return self.with_chosen([part.sample(generator)[agent] for agent, part in self._parts.items()])

    def mode(self) -> JointOptions:
        return self.with_chosen([part.mode()[agent] for agent, part in self._parts.items()])

    def entropy(self) -> float:
        return sum(part.entropy() for part in self._parts.values())

    def _rough_mode(self) -> JointOptions:
        return self.mode()


class Presence(JointPolicy):
    """A joint policy whose network has N additional inputs: 1 for each agent that is present, else 0.

    An agent is present if it chooses or runs an option.

    Args:
        policy: Joint policy of the network with these inputs.
    """

    def __init__(self, policy: JointPolicy) -> None:
        self.counts = policy.counts
        self.observation_size = policy.observation_size - len(policy.counts)
        self._policy = policy

    def valid(self, query: PolicyQuery) -> Conditional:
        """Return pi-hat."""
        observation = with_presence(query.observation, query.choosing | (query.running != NONE))
        return self._policy.valid(PolicyQuery(observation, query.choosing, query.running, query.legal))


def with_presence(observation: Array, present: Mask) -> Array:
    """Concatenate observations (..., D) and presence (..., N) to the network's input (..., D + N)."""
    return np.concatenate((observation, present.astype(observation.dtype)), axis=-1)
