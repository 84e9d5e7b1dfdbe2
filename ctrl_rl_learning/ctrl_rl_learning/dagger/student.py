"""The pupil: a small network that learns the teacher's commands from what the robot sees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ctrl_rl_core import Actor, PolicyManifest

_HIDDEN = 256
_BATCH = 256
_RATE = 1e-3
_DECAY = 1e-5


class Student:
    """A network from an observation in the interface's units to a command.

    Attributes:
        body: The network; tanh of its outputs are actions in [-1, 1].
        optimizer: Optimiser of the network, with its state.
    """

    def __init__(self, interface: PolicyManifest) -> None:
        self._interface = interface
        self._low = np.array(interface.action.low, np.float32)
        self._span = np.array(interface.action.high, np.float32) - self._low
        layers = (nn.Linear(interface.size, _HIDDEN), nn.Linear(_HIDDEN, _HIDDEN), nn.Linear(_HIDDEN, 2))
        self.body = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])
        self.optimizer = torch.optim.AdamW(self.body.parameters(), lr=_RATE, weight_decay=_DECAY)

    def command(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the command (2,) for an observation (n,)."""
        with torch.no_grad():
            action = torch.tanh(self.body(torch.from_numpy(observation))).numpy()
        return np.asarray(self._low + 0.5 * (action + 1.0) * self._span, np.float64)

    def fit(
        self,
        observations: NDArray[np.float32],
        commands: NDArray[np.float32],
        updates: int,
        random: np.random.Generator,
    ) -> float:
        """Learn the commands (N, 2) of observations (N, n), and return the mean squared error of the last tenth."""
        inputs = torch.from_numpy(observations)
        wanted = torch.from_numpy(2.0 * (commands - self._low) / self._span - 1.0)
        losses = []
        for count in range(updates):
            for group in self.optimizer.param_groups:
                group["lr"] = 0.5 * _RATE * (1.0 + math.cos(math.pi * count / updates))
            chosen = torch.from_numpy(random.integers(len(inputs), size=_BATCH))
            loss = self._loss(inputs[chosen], wanted[chosen])
            self.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
            losses.append(float(loss.detach()))
        return float(np.mean(losses[-max(1, updates // 10) :]))

    def _loss(self, inputs: Tensor, wanted: Tensor) -> Tensor:
        return nn.functional.mse_loss(torch.tanh(self.body(inputs)), wanted)

    def actor(self, manifest: Mapping[str, Any]) -> Actor:
        """Return the policy that a node drives by."""
        linear = [layer for layer in self.body if isinstance(layer, nn.Linear)]
        size = self._interface.size
        return Actor(
            weights=tuple(layer.weight.detach().numpy().copy() for layer in linear),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in linear),
            activation="relu",
            squashed=True,
            middle=np.zeros(size, np.float32),
            unit=np.ones(size, np.float32),
            low=self._low,
            high=self._low + self._span,
            manifest=manifest,
            interface=self._interface,
        )
