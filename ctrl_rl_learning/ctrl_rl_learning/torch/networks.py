"""Networks of policies and critics; a policy has the same network in its file and during training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import layer_norm, linear

from ctrl_rl_core import Actor, PolicyManifest

Vector = NDArray[np.float32]


def make_mlp(inputs: int, hidden: int, outputs: int, *, normalized: bool = False) -> nn.Sequential:
    """Return a network with two hidden ReLU layers, each with layer normalisation if `normalized`."""
    layers: list[nn.Module] = []
    width = inputs
    for _ in range(2):
        layers.append(nn.Linear(width, hidden))
        if normalized:
            layers.append(nn.LayerNorm(hidden, elementwise_affine=False))
        layers.append(nn.ReLU())
        width = hidden
    return nn.Sequential(*layers, nn.Linear(width, outputs))


def linear_arrays(layers: Iterable[nn.Module]) -> tuple[tuple[Vector, ...], tuple[Vector, ...]]:
    """Return the weights (out, in) and the biases (out,) of all linear layers, for an `Actor`."""
    chosen = [layer for layer in layers if isinstance(layer, nn.Linear)]
    weights = tuple(layer.weight.detach().numpy().copy() for layer in chosen)
    return weights, tuple(layer.bias.detach().numpy().copy() for layer in chosen)


def new_actor(
    interface: PolicyManifest, hidden: int, middle: Vector | None = None, unit: Vector | None = None
) -> Actor:
    """Return an untrained policy with two hidden layers and weights drawn from torch's generator.

    Args:
        interface: Observation and commands.
        hidden: Units of each hidden layer.
        middle: Observation that maps to 0 (n,); 0 by default.
        unit: Offset from `middle` that maps to 1 (n,); 1 by default.
    """
    weights, biases = linear_arrays(make_mlp(interface.size, hidden, 2))
    return Actor(
        weights=weights,
        biases=biases,
        activation="relu",
        squashed=True,
        middle=np.zeros(interface.size, np.float32) if middle is None else middle,
        unit=np.ones(interface.size, np.float32) if unit is None else unit,
        low=np.array(interface.action.low, np.float32),
        high=np.array(interface.action.high, np.float32),
        manifest={},
        interface=interface,
    )


class ActorNetwork(nn.Module):
    """Network of an actor, from observations (N, n) in the network's units to actions (N, 2) in [-1, 1]."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self._actor = actor
        self._kind = actor.activation.removeprefix("normalized_")
        self.weights = nn.ParameterList(torch.tensor(each) for each in actor.weights)
        self.biases = nn.ParameterList(torch.tensor(each) for each in actor.biases)

    def forward(self, x: Tensor) -> Tensor:
        """Return the actions; gradients pass straight through the clipping of an actor without tanh."""
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = linear(x, weight, bias)
            if index < len(self.weights) - 1:
                if self._kind != self._actor.activation:
                    x = layer_norm(x, x.shape[-1:])
                x = torch.tanh(x) if self._kind == "tanh" else torch.relu(x)
        return torch.tanh(x) if self._actor.squashed else x + (x.clamp(-1.0, 1.0) - x).detach()

    def to_actor(self, manifest: Mapping[str, Any]) -> Actor:
        """Return the current policy with entries added to its manifest."""
        return replace(
            self._actor,
            weights=tuple(each.detach().numpy().copy() for each in self.weights),
            biases=tuple(each.detach().numpy().copy() for each in self.biases),
            manifest={**self._actor.manifest, **manifest},
        )


def widen(actor: Actor, interface: PolicyManifest, units: Vector) -> Actor:
    """Return an actor with components appended to its observation; its commands stay the same until it learns.

    Args:
        actor: Actor for the shorter observation.
        interface: Interface with the longer observation.
        units: Value that maps to 1, for each added component (added,).
    """
    added = np.zeros((len(actor.weights[0]), len(units)), np.float32)
    return replace(
        actor,
        weights=(np.concatenate((actor.weights[0], added), axis=1), *actor.weights[1:]),
        middle=np.concatenate((actor.middle, np.zeros(len(units), np.float32))),
        unit=np.concatenate((actor.unit, units)),
        interface=interface,
    )


class Critics(nn.Module):
    """Twin critics of observations (N, n) and actions (N, 2), with layer normalisation against overestimation."""

    def __init__(self, inputs: int, hidden: int, actions: int = 2) -> None:
        super().__init__()
        self.first = make_mlp(inputs + actions, hidden, 1, normalized=True)
        self.second = make_mlp(inputs + actions, hidden, 1, normalized=True)

    def forward(self, observations: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return both values (N,)."""
        given = torch.cat((observations, actions), dim=-1)
        return self.first(given).squeeze(-1), self.second(given).squeeze(-1)

    def minimum(self, observations: Tensor, actions: Tensor) -> Tensor:
        """Return the smaller of both values (N,)."""
        return torch.minimum(*self(observations, actions))
