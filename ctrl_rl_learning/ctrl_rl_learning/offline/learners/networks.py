"""Networks of offline learners, and their actor as a file that a node runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ctrl_rl_core import Actor, PolicyManifest

Vectors = NDArray[np.float32]
_LEAST_UNIT = 1e-3


def make_mlp(inputs: int, hidden: int, outputs: int, *, normalized: bool = False) -> nn.Sequential:
    """Return a network of two hidden layers with ReLU, after a layer norm where `normalized`."""
    layers: list[nn.Module] = []
    width = inputs
    for _ in range(2):
        layers.append(nn.Linear(width, hidden))
        if normalized:
            layers.append(nn.LayerNorm(hidden, elementwise_affine=False))
        layers.append(nn.ReLU())
        width = hidden
    return nn.Sequential(*layers, nn.Linear(width, outputs))


class ActorNetwork(nn.Module):
    """A deterministic policy: observation (N, n) in units of order 1 to actions (N, 2) in [-1, 1]."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.body = make_mlp(inputs, hidden, 2)

    def forward(self, observations: Tensor) -> Tensor:
        """Return the actions."""
        return torch.tanh(self.body(observations))


class Critics(nn.Module):
    """Two critics of observations (N, n) and actions (N, 2), side by side, with layer norms against overestimation."""

    def __init__(self, inputs: int, hidden: int, actions: int = 2) -> None:
        super().__init__()
        self.first = make_mlp(inputs + actions, hidden, 1, normalized=True)
        self.second = make_mlp(inputs + actions, hidden, 1, normalized=True)

    def forward(self, observations: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return both values (N,)."""
        given = torch.cat((observations, actions), dim=-1)
        return self.first(given).squeeze(-1), self.second(given).squeeze(-1)

    def least(self, observations: Tensor, actions: Tensor) -> Tensor:
        """Return the lesser of both values (N,)."""
        return torch.minimum(*self(observations, actions))


def track(target: nn.Module, source: nn.Module, share: float) -> None:
    """Move a target network by a share of the way to its source."""
    with torch.no_grad():
        for slow, fast in zip(target.parameters(), source.parameters(), strict=True):
            slow.lerp_(fast, share)


def scales_of(observations: Vectors) -> tuple[Vectors, Vectors]:
    """Return middle and unit (n,), (n,) of observations (N, n): mean and spread, so that inputs are of order 1."""
    spread = observations.std(axis=0)
    return observations.mean(axis=0), np.where(spread > _LEAST_UNIT, spread, 1.0).astype(np.float32)


def to_actor(
    network: ActorNetwork, middle: Vectors, unit: Vectors, interface: PolicyManifest, manifest: Mapping[str, Any]
) -> Actor:
    """Return an actor's file content with its interface."""
    linear = [layer for layer in network.body if isinstance(layer, nn.Linear)]
    return Actor(
        weights=tuple(layer.weight.detach().numpy().copy() for layer in linear),
        biases=tuple(layer.bias.detach().numpy().copy() for layer in linear),
        activation="relu",
        squashed=True,
        middle=middle,
        unit=unit,
        low=np.array(interface.action.low, np.float32),
        high=np.array(interface.action.high, np.float32),
        manifest=manifest,
        interface=interface,
    )


def batches(
    tensors: tuple[Tensor, ...], size: int, count: int, random: np.random.Generator
) -> Iterator[tuple[Tensor, ...]]:
    """Yield `count` random batches of rows."""
    rows = len(tensors[0])
    for _ in range(count):
        chosen = torch.from_numpy(random.integers(rows, size=size))
        yield tuple(tensor[chosen] for tensor in tensors)
