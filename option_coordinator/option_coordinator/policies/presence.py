"""A joint policy that is told which agents are present; otherwise it takes absent agents for choosing ones."""

from __future__ import annotations

import numpy as np

from option_coordinator.options.decision import NONE, PolicyQuery
from option_coordinator.options.options import Mask
from option_coordinator.policies.joint_policy import Array, Conditional, JointPolicy


class Presence(JointPolicy):
    """A joint policy whose network sees N more numbers: 1 for an agent that is present, 0 for an absent one.

    An agent is present if it chooses or runs an option.

    Args:
        policy: Joint policy of the network that sees these numbers.
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
    """Return observations (..., D) and who is there (..., N) as the network sees them (..., D + N)."""
    return np.concatenate((observation, present.astype(observation.dtype)), axis=-1)
