"""The interface of learners of joint options."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from ctrl_rl_learning.torch.learner_state import Arrays
from numpy.typing import NDArray
from torch import Tensor, nn

from option_coordinator.data.trajectory import OptionTrajectory
from option_coordinator.policies.joint_policy import JointPolicy
from option_coordinator.policies.presence import with_presence
from option_coordinator.training.heads.head_parts import DecisionBatch


class Learner(ABC):
    """Learns a joint policy from option-level trajectories that it gathers itself.

    Attributes:
        network: Network of the joint policy.
        networks: All networks by name, for checkpoints.
        optimizers: All optimisers by name, for checkpoints.
        greedy: Whether the policy is used by its most likely options, not by draws.
        settings: Settings of the algorithm, a dataclass.
    """

    network: nn.Module
    networks: Mapping[str, nn.Module]
    optimizers: Mapping[str, torch.optim.Optimizer]
    greedy: bool
    settings: Any

    @abstractmethod
    def behaviour(self, progress: float) -> JointPolicy:
        """Return the behaviour policy of the next trajectory, when this part (0 to 1) of the run is done."""

    @abstractmethod
    def learn(self, trajectory: OptionTrajectory, generator: np.random.Generator) -> dict[str, float]:
        """Learn from a trajectory and return metrics of the update."""

    def descend(self, loss: Tensor) -> None:
        """Take a step down a loss, with the gradient of each network clipped to `settings.gradient_norm`."""
        (optimizer,) = self.optimizers.values()
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        for network in self.networks.values():
            if parameters := list(network.parameters()):
                nn.utils.clip_grad_norm_(parameters, self.settings.gradient_norm)
        optimizer.step()

    def memory(self) -> Arrays:
        """Return the rest of its state as arrays, for checkpoints."""
        return {}

    def recall(self, arrays: Mapping[str, NDArray[Any]]) -> None:  # noqa: B027 - most remember nothing
        """Take up what `memory` returned."""


def decision_batch(trajectory: OptionTrajectory, presence: bool = False) -> DecisionBatch:
    """Return a trajectory's decisions as tensors; with `presence` the observation tells which agents are present."""
    seen = trajectory.observation
    return DecisionBatch(
        observation=as_tensor(with_presence(seen, trajectory.present) if presence else seen),
        options=torch.from_numpy(trajectory.options),
        choosing=torch.from_numpy(trajectory.choosing),
        legal=torch.from_numpy(trajectory.legal),
    )


def as_tensor(array: NDArray[np.floating]) -> Tensor:
    """Return an array as a tensor of torch's default type."""
    return torch.from_numpy(array).to(torch.get_default_dtype())
