"""The base of joint policies that are one network."""

from __future__ import annotations

from option_coordinator.policies.joint_policy import JointPolicy
from option_coordinator.policies.network import Tensors


class NetworkPolicy(JointPolicy):
    """A joint policy with MAPPO's trunk, which observes what the trunk's first norm takes.

    Args:
        tensors: Tensors of the trunk and of the head, by the names that the subclass gives.
        counts: Number of options of each agent.
    """

    def __init__(self, tensors: Tensors, counts: tuple[int, ...]) -> None:
        self.counts = counts
        self.observation_size = tensors["trunk.norm_0.weight"].shape[0]
        self._tensors = tensors
