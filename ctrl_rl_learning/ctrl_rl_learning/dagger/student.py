"""The student: a small network that learns the expert's commands from the robot's observations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import mse_loss

from ctrl_rl_core import Actor, PolicyManifest
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.torch.networks import ActorNetwork, new_actor
from ctrl_rl_learning.torch.optimization import anneal_lr, gradient_step

_HIDDEN, _BATCH, _RATE, _DECAY = 256, 256, 1e-3, 1e-5


class Student:
    """Network that maps an observation in the interface's units to a command.

    Attributes:
        network: Network of the policy.
        optimizer: Optimiser of the network, with its state.
    """

    def __init__(
        self,
        interface: PolicyManifest,
        middle: NDArray[np.float32] | None = None,
        unit: NDArray[np.float32] | None = None,
    ) -> None:
        """Create an untrained network.

        Args:
            interface: Observation and commands.
            middle: Observation in the interface's units that maps to 0 (n,); 0 by default.
            unit: Offset from `middle` that maps to 1 (n,); 1 by default.
        """
        untrained = new_actor(interface, _HIDDEN, middle, unit)
        self._middle, self._unit = untrained.middle, untrained.unit
        self._low, self._span = untrained.low, untrained.high - untrained.low
        self.network = ActorNetwork(untrained)
        self.optimizer = torch.optim.AdamW(self.network.parameters(), lr=_RATE, weight_decay=_DECAY)

    def command(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the command (2,) for an observation (n,)."""
        with torch.no_grad():
            action = self.network(torch.from_numpy((observation - self._middle) / self._unit)).numpy()
        return np.asarray(self._low + 0.5 * (action + 1.0) * self._span, np.float64)

    def fit(
        self,
        observations: NDArray[np.float32],
        commands: NDArray[np.float32],
        updates: int,
        random: np.random.Generator,
    ) -> float:
        """Fit commands (N, 2) to observations (N, n); return the mean squared error over the last tenth of updates.

        Raises:
            LearningError: An observation or a command is not finite.
        """
        if not (np.isfinite(observations).all() and np.isfinite(commands).all()):
            raise LearningError("observations or commands to learn from are not finite")
        inputs = torch.from_numpy((observations - self._middle) / self._unit)
        wanted = torch.from_numpy(2.0 * (commands - self._low) / self._span - 1.0)
        losses = []
        for count in range(updates):
            anneal_lr((self.optimizer,), _RATE, count / updates)
            chosen = torch.from_numpy(random.integers(len(inputs), size=_BATCH))
            loss = mse_loss(self.network(inputs[chosen]), wanted[chosen])
            gradient_step(self.optimizer, loss)
            losses.append(float(loss.detach()))
        return float(np.mean(losses[-max(1, updates // 10) :]))

    def actor(self, manifest: Mapping[str, Any]) -> Actor:
        """Return the policy for deployment on a node."""
        return self.network.to_actor(manifest)
